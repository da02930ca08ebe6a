"""How records show themselves: their headlines, and the text and HTML for terminal and notebook.

Text and HTML are registered on import.  The headline is the one line that stands if the whole report would be too
much.
"""

from functools import partial

from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.fit_report import summary_html, summary_report
from imubayes.display.loop.change_report import change_report, injection_report
from imubayes.display.loop.diagnosis_report import diagnosis_report
from imubayes.display.loop.history import history_report
from imubayes.display.loop.prediction_report import prediction_report, repeatability_report
from imubayes.display.numbers_and_labels import significant
from imubayes.display.shown_records import shown_as
from imubayes.foundations.records import html_of
from imubayes.foundations.wording import counted
from imubayes.loop.injection_recovery import Trials
from imubayes.loop.model_history import Tree
from imubayes.results.change_records import ModelChange
from imubayes.results.history_tree import shown_place
from imubayes.results.prediction import RunPrediction
from imubayes.results.repeatability import Repeatability
from imubayes.results.result import Result


def result_headline(result: Result) -> str:
    """Return campaign, model, convergence, goodness of fit and place of a result."""
    summary = result.summary
    fit = "" if summary.chi2 is None else f", χ² {summary.chi2:.0f} for {summary.dof:.0f} degrees of freedom"
    state = "converged" if summary.converged else "NOT CONVERGED"
    how = "sampled" if summary.sampled else "Laplace approximation"
    where = f", in {result.folder}" if result.folder is not None else ""
    count = counted(len(summary.parameters), "parameter")
    return f"<Result {summary.campaign}, model {summary.model}: {state}{fit}, {count}, {how}{where}>"


def diagnosis_headline(found: Diagnosis) -> str:
    """Return the verdict and what to add."""
    verdict, choice = found.verdict.replace("_", " "), found.suggested
    return f"<Diagnosis {verdict}{'' if choice is None else ': ' + _on(', '.join(choice.effects), choice.channels)}>"


def change_headline(change: ModelChange) -> str:
    """Return what was added, removed and edited, whether it was taken, and Δχ²."""
    names = [f"{sign} {_on(each.effect, each.channels)}" for sign, each in change.signed]
    names += [f"prior of {name}" for name in change.priors]
    names += [f"readings of {each.run}" for each in (*change.set_aside, *change.taken_back)]
    taken = "taken" if change.taken else "not taken"
    return f"<ModelChange {', '.join(names)}: {taken}, Δχ² {significant(change.observed.delta_chi2)}>"


def tree_headline(tree: Tree) -> str:
    """Return how many models were tried and which is selected."""
    return (
        f"<Tree {counted(len(tree.nodes), 'model')}, selected: {', '.join(map(shown_place, tree.selected)) or 'none'}>"
    )


def trials_headline(trials: Trials) -> str:
    """Return how many injected effects were detected."""
    return f"<Trials {trials.campaign}: {trials.detected} of {len(trials.trials)} injected effects detected>"


def prediction_headline(found: RunPrediction) -> str:
    """Return the verdict and χ²/n."""
    about = found.summary
    said = f"{about.verdict.replace('_', ' ')}, χ² {significant(about.chi2)} for {about.n}"
    return f"<RunPrediction {about.campaign} by {about.result_campaign}: {said}>"


def repeatability_headline(found: Repeatability) -> str:
    """Return whether two calibrations agree."""
    said = f"{found.verdict}, χ² {significant(found.chi2)} for {found.freedom}"
    return f"<Repeatability {' and '.join(found.campaigns)}: {said}>"


def _on(effects: str, channels: tuple[str, ...] | None) -> str:
    return effects + (f" on {', '.join(channels)}" if channels else "")


_SHOWN = {
    Result: (result_headline, lambda result: summary_report(result.summary)),
    ModelChange: (change_headline, partial(change_report, verbose=True)),
    Diagnosis: (diagnosis_headline, partial(diagnosis_report, verbose=True)),
    Tree: (tree_headline, history_report),
    Trials: (trials_headline, injection_report),
    RunPrediction: (prediction_headline, partial(prediction_report, verbose=True)),
    Repeatability: (repeatability_headline, partial(repeatability_report, verbose=True)),
}
for _record, (_headline, _report) in _SHOWN.items():
    shown_as(_record, _headline, _report)
html_of.register(Result, lambda result: summary_html(result.summary))
