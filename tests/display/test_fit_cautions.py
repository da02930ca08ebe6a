"""The first line holds the caution that a reader needs before the numbers."""

import json

import pytest
import synthetic_results as made

from imubayes.adequacy.adequacy_record import KnownNoiseFit, NoiseComparison, NoiseViolation
from imubayes.display.fit_cautions import alarm_of, exact_lines, next_command, notices
from imubayes.display.fit_report import summary_html, summary_report
from imubayes.display.layout import report_text
from imubayes.inference.identifiability import ImplausibleEstimate, UnexplainedOutput
from imubayes.model.model_file import UncertainEquipment
from imubayes.results.summary import DerivedSummary, PriorScatter, Summary

GAIN = "injection_error.gain[ax]"
VIOLATIONS = (
    NoiseViolation(kind="quantisation", channels=("ax",), step=3.1),
    NoiseViolation(kind="autocorrelation", channels=("gx", "gy"), p=3e-7),
)
SCATTER = PriorScatter(scale="run_scatter.tau[ax]", from_data=0.02, parameters=(GAIN,), factor=3.5)


@pytest.fixture(scope="module")
def plain() -> Summary:
    return made.summary_of(made.trihedral_residuals())


def test_nothing_is_said_of_a_sound_fit(plain):
    assert alarm_of(plain) == ""
    assert notices(plain) == ()
    assert next_command(plain, "data/unit", "results/unit") == "imubayes compare results/unit"


def test_the_last_lines_repeat_the_outcome(plain):
    """The first line of a long output has left the screen."""
    flawed = plain.model_copy(update={"intervals_valid": False, "noise_violations": VIOLATIONS})
    stuck = plain.model_copy(update={"converged": False, "message": "R-hat 1.4"})
    outcomes = [summary_report(each).closing[-1].partition(" χ²")[0] for each in (plain, flawed, stuck)]
    assert outcomes == [
        "Converged. The data determined 82 of 86 parameters.",
        "Converged, but the intervals cannot be trusted. The first line gives the reason.",
        "The fit did not converge. The first line gives the reason.",
    ]


def test_what_the_intervals_take_as_exact_is_said_where_it_matters(plain):
    gravity = UncertainEquipment(
        effect="gravity_anomaly", parameter="gravity_anomaly.anomaly[all]", unit="ug", size=50.0, stated=False
    )
    rate = UncertainEquipment(
        effect="table_rate_error", parameter="table_rate_error.rate_error[t]", unit="ppm", size=4.0, stated=True
    )
    scale = DerivedSummary(name="scale_factor[ax]", unit="pulse/s per g", mean=2e4, sd=0.2)

    def said(exact, sd: float) -> str:
        derived = (scale.model_copy(update={"sd": sd}),)
        return " ".join(exact_lines(plain.model_copy(update={"exact": exact, "derived": derived})))

    assert said((), 0.2) == ""
    told = said((gravity,), 0.2)
    assert "Taken as exact by the model: gravity anomaly (u = 50 µg, assumed for normal gravity). The" in told
    assert "There, the standard uncertainty of scale_factor[ax] is 51 ppm instead of 10 ppm, if" in told
    assert said((gravity,), 20.0) == ""  # 1000 ppm: nothing that 50 ppm would change
    stated = said((gravity, rate), 20.0)
    assert "table rate error (u = 4.0 ppm, stated)" in stated
    assert "gravity" not in stated
    closing = " ".join(summary_report(plain.model_copy(update={"exact": (rate,)})).closing)
    assert "table rate error" in closing


def test_noise_that_contradicts_what_is_known_precedes_everything(plain):
    told = NoiseComparison("ax", 212.0, 4.0, "samples", 53.0, 0.9, 1e-300, False, "LSB", 87.0, "white_noise.sigma[ax]")
    known = KnownNoiseFit(chi2=8.1e5, dof=288, channels=())
    flawed = plain.model_copy(update={"noise_contradicted": (told,), "known_noise": known})
    text = " ".join(report_text(summary_report(flawed), width=400).split())
    assert text.startswith(
        "DO NOT TRUST THE INTERVALS: white_noise.sigma[ax] is 53.00 ± 0.90 times the noise of the raw samples of the"
    )
    assert "degrees of freedom at the noise as fitted, 810000.0 for 288 at the noise known beforehand. Fit" in text
    assert next_command(flawed, "data/unit", "results/unit") == "imubayes diagnose results/unit"
    assert summary_html(flawed).index("DO NOT TRUST") < summary_html(flawed).index("<table")
    both = flawed.model_copy(update={"noise_violations": VIOLATIONS})
    assert alarm_of(both).count("DO NOT TRUST") == 1
    assert "time longer than a row). Tests of the residuals: the output is quantised" in alarm_of(both)
    # A result that was written and read again says the same.
    assert alarm_of(Summary.model_validate_json(flawed.model_dump_json())) == alarm_of(flawed)


def test_intervals_that_cannot_be_trusted_are_said_on_the_first_line(plain):
    flawed = plain.model_copy(update={"intervals_valid": False, "noise_violations": VIOLATIONS})
    text = " ".join(report_text(summary_report(flawed), width=400).split())
    assert text.startswith("DO NOT TRUST THE INTERVALS: the output is quantised too coarsely for its noise (ax: a step")
    assert text.count("DO NOT TRUST") == 1
    assert next_command(flawed, "data/unit", "results/unit") == "imubayes diagnose results/unit"
    assert "the residuals are autocorrelated (gx, gy, p = 3e-07)" in text
    assert summary_html(flawed).index("DO NOT TRUST") < summary_html(flawed).index("<table")
    document = json.loads(flawed.model_dump_json())
    assert document["intervals_valid"] is False
    assert document["noise_violations"][1] == {
        "kind": "autocorrelation",
        "channels": ["gx", "gy"],
        "p": 3e-7,
        "step": None,
    }


def test_suspected_noise_is_a_notice_and_no_alarm(plain):
    doubted = plain.model_copy(update={"noise_suspected": VIOLATIONS[1:]})
    assert alarm_of(doubted) == ""
    (notice,) = notices(doubted)
    assert notice.startswith("Suspected: the residuals are autocorrelated (gx, gy, p = 3e-07). This may be chance.")
    assert notice in " ".join(report_text(summary_report(doubted), width=400).split())
    assert "Suspected:" in summary_html(doubted)
    # If there is an alarm it says enough.
    assert notices(doubted.model_copy(update={"noise_violations": VIOLATIONS})) == ()


def test_a_fit_that_failed_says_so_first(plain):
    scale = ImplausibleEstimate(
        reason="outside_domain", name="gyro_scale_factor.scale[gx]", unit="ppm", value=-2_000_088.0,
        lowest=-1e6, highest=1e6, prior_mean=0.0, prior_sd=2000.0, distance=1000.0,
    )  # fmt: skip
    output = UnexplainedOutput(channel="ax", unit="g", residual=0.7, within_runs=0.7, output=0.8, noise=7e-6)
    failed = plain.model_copy(update={"converged": False, "implausible": (scale,), "unexplained": (output,)})
    text = " ".join(report_text(summary_report(failed), width=400).split())
    assert text.startswith("FIT FAILED. gyro_scale_factor.scale[gx] = -2000000 ppm is physically impossible")
    assert "(possible: -1000000 to 1000000 ppm)" in text
    assert "The residuals of ax are 0.70 g rms, 100000 times the recorded noise; the outputs are 0.80 g rms." in text
    assert "No estimate of this fit can be used." in text
    assert text.count("FIT FAILED") == 1
    assert next_command(failed, "data/unit", "results/unit") == "imubayes check data/unit"
    far = scale.model_copy(update={"reason": "far_from_prior", "value": 1e5, "distance": 50.0})
    assert "is 50 prior standard deviations from its prior, 0 ± 2000 ppm." in alarm_of(
        plain.model_copy(update={"implausible": (far,)})
    )


def test_what_rests_on_a_prior_is_said_first_unless_a_warning_is(plain):
    resting = plain.model_copy(update={"prior_scatter": (SCATTER,)})
    first = report_text(summary_report(resting), width=400).splitlines()[0]
    assert first.startswith("run_scatter.tau[ax] depends on its prior (2 % from the data)")
    assert f"so do the intervals of {GAIN}" in first
    flawed = resting.model_copy(update={"intervals_valid": False, "noise_violations": VIOLATIONS})
    text = report_text(summary_report(flawed), width=400)
    assert text.startswith("DO NOT TRUST")
    assert "depends on its prior" in text
