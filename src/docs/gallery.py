"""Pages of the gallery of effects: one for each member of the catalogue, from its class and from its responses."""

import inspect
import tomllib
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from reference_pages import Pages, table
from responses import CAMPAIGNS, DRAWN, SHOWN, Left, LinearCampaign

from imubayes.display.effect_catalogue import _acts_on
from imubayes.display.figure_style import BAND, BLUE, QUIET, STYLE
from imubayes.effects.base import Effect, Order
from imubayes.effects.shared_formulas import Sensor
from imubayes.foundations.covariates import remedy
from imubayes.foundations.units import BIAS_CONVENTION
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.parameters.declarations import declared_options, declared_parameters
from imubayes.responses.residual_covariates import ResidualCovariate

CAUSES = tomllib.loads((Path(__file__).parent / "causes.toml").read_text(encoding="utf-8"))
_TEXT = {file.stem: file.read_text(encoding="utf-8") for file in (Path(__file__).parent / "_templates").glob("*.md")}


def gallery_pages(source: Path) -> Pages:
    """Return the pages of all effects and their index; pictures are written below `source`."""
    folder = source / "effects"
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = [each for part in pool.map(_drawn, CAMPAIGNS, [folder] * len(CAMPAIGNS)) for each in part]
    return effect_pages(found)


def _drawn(campaign: str, folder: Path) -> list[Left]:
    """Return what every effect leaves in a campaign; the pictures of those that stand out are written."""
    found = list(LinearCampaign(campaign).left_by_all())
    for left in found:
        if left.standing >= SHOWN:
            draw(left, folder / _picture(left))
    return found


def _picture(left: Left) -> str:
    return f"{left.effect}-{left.procedure}.svg"


def draw(left: Left, file: Path) -> None:
    """Draw response and residual of one channel against their covariate."""
    x = left.covariate.values
    chosen = np.unique(np.linspace(0, len(x) - 1, min(len(x), 600)).astype(int))
    with mpl.rc_context({**STYLE, "svg.fonttype": "none", "svg.hashsalt": left.effect}):
        figure = Figure(figsize=(6.0, 3.7), layout="constrained")
        FigureCanvasSVG(figure)
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot(x[chosen], left.response[chosen], "o", color=QUIET, markersize=3)
        order = chosen[np.argsort(x[chosen], kind="stable")]
        below.fill_between(x[order], -left.noise[order], left.noise[order], color=BAND, linewidth=0)
        below.plot(x[chosen], left.left[chosen], "o", color=BLUE, markersize=3)
        unit = f" / {left.covariate.unit}" if left.covariate.unit else ""
        below.set_xlabel(left.covariate.phrase + unit)
        above.set_ylabel(f"response / {left.unit}")
        below.set_ylabel(f"left / {left.unit}")
        figure.savefig(file, format="svg", metadata={"Date": None})


def effect_pages(found: Sequence[Left]) -> Pages:
    """Return a page for each member of the catalogue, and the index."""
    members = Registry().effects
    by_effect: dict[str, list[Left]] = {name: [] for name in members}
    for left in found:
        by_effect[left.effect].append(left)
    pages = {f"effects/{name}.md": _page(members[name], lefts) for name, lefts in by_effect.items()}
    return {"effects/index.md": _index(members, by_effect), **pages}


def _page(member: EffectClass, lefts: Sequence[Left]) -> str:
    formula, _, further = (inspect.getdoc(member) or "").partition("\n\n")
    acts_on_input = issubclass(member, Sensor)
    bias = BIAS_CONVENTION if acts_on_input and member.order == Order.BIAS else ""
    facts = [
        ("acts on", _acts_on(member)),
        ("needs of a run", "; ".join(dict.fromkeys(map(remedy, member.needs))) or "nothing special"),
        ("one value per", ", ".join(member.per)),
        ("not together with", _links(member.excludes)),
        ("axes", f"I, O, {'S' if 'gyro' in member.kinds else 'P'} = I × O: {_FRAMES}" if acts_on_input else ""),
        ("confused with", member.confused_with),
        ("settings", ", ".join(f"`{name}` = {value:g}" for name, value in declared_options(member).items())),
        ("source", member.reference),
    ]
    parts = [
        f"# {member.name}\n",
        CAUSES[member.name] + "\n",
        "```{admonition} Formula\n" + _plain(formula) + "\n```\n",
        _plain(further) + "\n",
        bias + "\n",
        table(("", ""), [fact for fact in facts if fact[1]]),
        "## Parameters\n",
        _parameters(member),
        f'In a model file: `[[effect]]` with `name = "{member.name}"`.\n',
    ]
    if issubclass(member, Effect):
        parts += _left_behind(lefts)
    return "\n".join(part for part in parts if part.strip())


_FRAMES = "[frames and signs](../explanation/signal-path.md#frames-and-signs)"


def _plain(text: str) -> str:
    return text.replace("*", "\\*").replace("<", "&lt;").replace("``", "`")


def _links(names: Iterable[str]) -> str:
    return ", ".join(f"[`{name}`]({name}.md)" for name in names)


def _parameters(member: EffectClass) -> str:
    rows = []
    for name, declared in declared_parameters(member).items():
        low, high = declared.typical
        scanned = f"; `diagnose` scans {', '.join(f'{each:g}' for each in declared.shape)}" if declared.shape else ""
        wider = [f"{declared.prior_of(grade)} ({grade})" for grade in ("industrial", "consumer")]
        priors, met = [declared.prior, *(wider if declared.coarse is not None else [])], f"{low:g} … {high:g}"
        if declared.of_gyro is not None:
            of_gyro, (low, high) = declared.of_gyro
            priors, met = [*priors, f"{of_gyro} (gyro)"], f"{met}; {low:g} … {high:g} (gyro)"
        rows.append((f"`{name}`", declared.meaning + scanned, declared.unit, met, "; ".join(priors)))
    return table(("parameter", "meaning", "unit", "met in practice", "default prior"), rows)


def _left_behind(lefts: Sequence[Left]) -> list[str]:
    if not lefts:
        return ["## What it leaves in the residuals\n", "No run of the campaigns that are drawn here responds to it.\n"]
    lefts = sorted(lefts, key=lambda left: -left.standing)
    shown = [left for left in lefts if left.standing >= SHOWN]
    figures = [f"```{{figure}} {_picture(left)}\n:alt: {_said(left)}\n\n{_said(left)}\n```\n" for left in shown]
    rows = [
        (
            f"`{left.procedure}`", _rounded(left.standing), _percent(left.retained),
            ", ".join(f"{family} {_percent(share)}" for family, share in left.absorbed) or "–",
            ", ".join(f"[{name}]({name}.md) {_percent(share)}" for name, share in left.imitators) or "–",
        )
        for left in lefts
    ]  # fmt: skip
    none = "At the largest size met in practice, no run that is drawn here shows it.\n"
    header = ("procedure", "significance", "retained", "absorbed by", "imitated by")
    parts = [_filled("left", figures="\n".join(figures) or none, shown=f"{SHOWN:g}", table=table(header, rows))]
    runs = [
        (f"`{left.procedure}`", _links([left.imitators[0][0]]), *_separating(left.separating))
        for left in shown if left.separating is not None
    ]  # fmt: skip
    runs += [
        (f"`{left.procedure}`", f"`{left.absorbed[0][0]}` of the model", *_separating(left.freeing))
        for left in lefts if left.freeing is not None
    ]  # fmt: skip
    if runs:
        parts.append(
            _filled("separating", table=table(("in addition to the runs of", "from", "further run", "Δχ²"), runs))
        )
    return parts


def _said(left: Left) -> str:
    drawn = f"`{left.coefficient.name}` = {left.coefficient.size:.3g} {left.coefficient.unit}"
    seen = pattern(left)
    return f"`{left.procedure}` (campaign `{left.campaign}`): {drawn}. Residual of {left.channel}: {seen}."


_LEAST = 0.9
"""Share of the square sum that a curve has to describe to be named."""

_PLAIN = 0.1
"""Share of its response that the model has to leave for the pattern to be one by which to look for the effect."""


def pattern(left: Left) -> str:
    """Return the simplest curve that describes what is left, with its share of the square sum, in words."""
    x, of, y = left.covariate, left.covariate.phrase, left.left
    if (share := float(len(y) * y.mean() ** 2 / (y @ y))) >= _LEAST:
        return f"constant in {of} ({_percent(share)} of its square sum)"
    curves = _curves(x)
    others = [z for z in left.others if z.name != x.name and not (z.periodic or x.periodic)]
    runs = (left.run[:, None] == np.unique(left.run)).astype(float)
    each_run = [
        {
            f"in each run {name} in {of}": (runs[:, :, None] * design[:, None, :]).reshape(len(runs), -1)
            for name, design in group.items()
        }
        for group in curves
    ]
    groups = [
        *(
            {f"{name} in {of}{beside}": np.hstack([design, columns]) for name, design in group.items()}
            for group in curves
            for beside, columns in (("", runs[:, :0]), (", beside an offset of each run", runs))
        ),
        {f"straight lines in {of} and in {z.phrase}": np.stack([x.values, z.values], axis=1) for z in others},
        each_run[0],
        {
            f"the product of {of} and {z.phrase}": np.stack([x.values * z.values, x.values, z.values], axis=1)
            for z in others
        },
        *each_run[1:],
    ]
    for group in groups:
        shares = {name: _described(y, design) for name, design in group.items()}
        best = max(shares, key=shares.__getitem__, default="")
        if shares.get(best, 0.0) >= _LEAST:
            return f"{best} ({_percent(shares[best])} of its variance)"
    return f"no simple curve in {of}, and no product with another input"


def _described(y: np.ndarray, design: np.ndarray) -> float:
    """Return the share of a variance that columns describe, less what chance gives; 0 if many rows have none."""
    known = np.isfinite(design).all(axis=1)
    columns, y = design[known] - design[known].mean(axis=0), y[known] - y[known].mean()
    columns /= np.maximum(np.abs(columns).max(axis=0, initial=0), 1e-300)
    fitted, _, rank, _ = np.linalg.lstsq(columns, y)
    free = len(y) - rank - 1
    if free < len(y) / 2 or known.mean() < _LEAST:
        return 0.0
    missed = y - columns @ fitted
    return 1 - float(missed @ missed) / free * (len(y) - 1) / float(y @ y)


def _curves(covariate: ResidualCovariate) -> list[dict[str, np.ndarray]]:
    """Return columns of curves beside a constant, in groups, the simplest first.

    A curve that is odd or even about zero needs both signs.
    """
    x = covariate.values
    if covariate.periodic:
        angle = np.deg2rad(x) if covariate.unit == "deg" else x
        once, twice, thrice = ([np.cos(k * angle), np.sin(k * angle)] for k in (1, 2, 3))
        named = [
            {"one period a turn": once, "two periods a turn": twice, "three periods a turn": thrice},
            {"periods once and twice a turn": once + twice, "periods once and three times a turn": once + thrice},
        ]
    else:
        x = x / (np.nanmax(np.abs(x)) or 1.0)
        bent = {"a parabola": [x, x**2]}
        if np.nanmin(x) < 0 < np.nanmax(x):
            bent["two straight lines that meet at zero"] = [x, np.abs(x)]
            bent["a step at zero"] = [x, np.sign(x)]
            bent["a parabola of opposite sign below zero"] = [x, x * np.abs(x)]
        named = [{"a straight line": [x]}, bent, {"a cubic": [x, x**2, x**3]}]
    return [{name: np.stack(columns, axis=1) for name, columns in group.items()} for group in named]


def _separating(told: tuple[str, float, float]) -> tuple[str, str]:
    run, before, after = told
    return run, f"{_rounded(before)} → {_rounded(after)}"


def _rounded(value: float) -> str:
    return "< 1" if value < 1 else f"{value:.2g}" if value < 100 else f"{value:.0f}" if value < 1000 else "> 1000"


def _filled(text: str, **values: str) -> str:
    filled = _TEXT.get(text, text)
    for name, value in values.items():
        filled = filled.replace(f"{{{name}}}", value)
    return filled


def _percent(share: float) -> str:
    if not 0.001 < share < 0.995:
        return "> 99 %" if share > 0.5 else "< 0.1 %"
    return f"{100 * share:.2g} %"


def _index(members: dict[str, EffectClass], found: dict[str, list[Left]]) -> str:
    groups: dict[str, list[str]] = {}
    for name, member in members.items():
        groups.setdefault(_acts_on(member), []).append(name)
    parts = []
    for group, names in groups.items():
        parts.append(f"## {group[0].upper()}{group[1:]}\n\n::::{{container}} thumbnails")
        for name in names:
            best = max(found[name], key=lambda left: left.standing, default=None)
            drawn = best is not None and best.standing >= SHOWN
            picture = f"[![{name}]({_picture(best)})]({name}.md)\\\n" if best is not None and drawn else ""
            parts.append(f":::{{container}} thumbnail\n{picture}[{name}]({name}.md)\n:::")
        parts.append("::::\n")
    return _filled(
        (Path(__file__).parent / "effects" / "index.md").read_text(encoding="utf-8"),
        members=str(len(members)), thumbnails="\n".join(parts), drawn=f"{DRAWN:g}", tree="\n".join(members),
        campaigns=", ".join(f"`{name}`" for name in CAMPAIGNS), patterns=_by_pattern(found.values()),
    )  # fmt: skip


def _by_pattern(found: Iterable[Sequence[Left]]) -> str:
    """Return a table of the patterns that have a name, with the effects that leave them."""
    seen: dict[str, dict[str, None]] = {}
    for left in (left for lefts in found for left in lefts if left.standing >= SHOWN and left.retained >= _PLAIN):
        said, share, _ = pattern(left).partition(" (")
        if share:
            seen.setdefault(said.partition(",")[0], {})[left.effect] = None
    ordered = sorted(seen, key=lambda said: said.rpartition(" in ")[2])
    return table(("residual", "effects that leave it"), [(said, _links(seen[said])) for said in ordered])
