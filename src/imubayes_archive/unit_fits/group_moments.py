"""Moments of the readings of a unit by run and channel, and from them the Laplace marginal of its noise scales.

A reading depends on few parameters, and all readings of one run and channel, a group, depend on the same ones.  The
Jacobian is kept by colour (see `imubayes.model.problem.Sparsity`), a few columns instead of one for each parameter, and
the normal equations are added up group by group.  If the noise of a group changes only by a factor, moments that are
computed once serve all noise scales.

The marginal depends on the noise scales through two numbers of each group, the variance v of its readings and the
variance T that they share, and through the precisions W of priors whose width is learnt.  With Q the precision of the
parameters and μ the step to their mode, r = y − J μ the residuals of a group, D their relative variances, n = 1ᵀD⁻¹1, ρ
= 1ᵀD⁻¹r and κ = T / (v (v + n T)), the derivatives are those of restricted maximum likelihood (Patterson & Thompson
1971), ½ rᵀΣ⁻¹ ∂Σ Σ⁻¹r − ½ tr(P ∂Σ).  Of Q⁻¹ they need only the blocks of the groups.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Float, Int, Scalar, take
from imubayes.model.problem import NoiseLayer, Problem, predict, prior_widths
from imubayes.noise.components import Entry, EntryNoise, SeriesNoise, SharedNoise, TailNoise


class GroupIndex(eqx.Module):
    """Places of the readings and parameters of each of G groups.

    Attributes
    ----------
    members : shape (G, M), readings of each group, E where padded.
    columns : shape (G, K), parameter of each colour in each group, P where there is none.
    patterns : shape (U, K), the rows of `columns` that differ.
    pattern : shape (G,), place among them.
    alike : shape (U, R), the groups of each pattern, G where padded.
    first : shape (G,), a reading of each group.
    proportional : whether the variances of all readings of a group change by one factor; static.
    """

    members: Int[Array, "G M"] | np.ndarray
    columns: Int[Array, "G K"] | np.ndarray
    patterns: Int[Array, "U K"] | np.ndarray
    pattern: Int[Array, " G"] | np.ndarray
    alike: Int[Array, "U R"] | np.ndarray
    first: Int[Array, " G"] | np.ndarray
    proportional: bool = eqx.field(static=True)


def group_index(problem: Problem) -> GroupIndex | None:
    """Return the places for a problem; None if it cannot be treated by groups.

    That is if rows are correlated, noise has heavy tails, or readings of one group have different parameters; and
    if there is no noise scale, or a prediction is none of the signal path alone.
    """
    if problem.transitions is not None or problem.servos is not None or problem.timeline is not None:
        return None
    if any(issubclass(layer.noise, SeriesNoise | TailNoise) for layer in problem.noise) or problem.size[1] == 0:
        return None
    members, reach = np.asarray(problem.observations.members), np.asarray(problem.sparsity.reach)
    colour, count = np.asarray(problem.sparsity.colour), reach.shape[1]
    padded = np.concatenate([reach, np.zeros((1, count), dtype=bool)])[members]
    first = members[:, 0]
    if np.any((padded != reach[first][:, None]) & (members < len(reach))[..., None]):
        return None
    columns = np.full((len(members), len(problem.sparsity.seeds)), count)
    for group, own in enumerate(reach[first]):
        columns[group, colour[own]] = np.flatnonzero(own)
    patterns, pattern = np.unique(columns, axis=0, return_inverse=True)
    pattern = pattern.reshape(-1)
    alike = np.full((len(patterns), np.bincount(pattern).max()), len(columns))
    for place, row in enumerate(alike):
        own = np.flatnonzero(pattern == place)
        row[: len(own)] = own
    return GroupIndex(members, columns, patterns, pattern, alike, first, _is_proportional(problem, members))


def _is_proportional(problem: Problem, members: np.ndarray) -> bool:
    """Return whether variances within each group keep their ratios whatever the noise scales are."""
    places = np.where(members < len(problem.observations.value), members, members[:, :1])
    ratios = []
    for step in (0.0, 0.7, -1.3):
        h = jnp.linspace(step, 1.5 * step, problem.size[1])
        variance = np.asarray(_compiled_variances(problem, h))[places]
        ratios.append(variance / variance[:, :1])
    return bool(np.allclose(ratios[0], ratios[1], rtol=1e-9) and np.allclose(ratios[0], ratios[2], rtol=1e-9))


class Moments(eqx.Module):
    """Sums over the readings of each group, weighted by their inverse variances.

    Attributes
    ----------
    gram : shape (G, K, K), of the Jacobian with itself.
    along, pulled : shape (G, K), of the Jacobian, and of the Jacobian with the misfit.
    mean, square, information : shape (G,), of the misfit, of its square, and of 1.
    log_variance : shape (G,), sum of the logarithms of the variances.
    """

    gram: Float[Array, "G K K"]
    along: Float[Array, "G K"]
    pulled: Float[Array, "G K"]
    mean: Float[Array, " G"]
    square: Float[Array, " G"]
    information: Float[Array, " G"]
    log_variance: Float[Array, " G"]


class GroupedModel(eqx.Module):
    """The model linearised about z, by groups.

    Attributes
    ----------
    z : shape (P,).
    packed : shape (G, M, K), Jacobian of the prediction by colour, 0 where padded.
    misfit : shape (G, M), observed less predicted, 0 where padded.
    weight, relative : shape (G, M), 1 for readings that count; variance relative to that of the group.
    moments : with these relative variances.
    """

    z: Float[Array, " P"]
    packed: Float[Array, "G M K"]
    misfit: Float[Array, "G M"]
    weight: Float[Array, "G M"]
    relative: Float[Array, "G M"]
    moments: Moments


def by_group(index: GroupIndex, values: Float[Array, "E *columns"], fill: float = 0.0) -> Array:
    """Return values of readings as (G, M, …), `fill` if padded."""
    padded = jnp.concatenate([values, jnp.full((1, *values.shape[1:]), fill)])
    return take(padded, index.members)


def grouped_misfit(problem: Problem, index: GroupIndex, z: Float[Array, " P"]) -> Float[Array, "G M"]:
    """Return observed less predicted, by group, 0 for readings that do not count."""
    observations = problem.observations
    return by_group(index, observations.weight * (observations.value - predict(problem, z)))


def grouped_model(problem: Problem, index: GroupIndex, z: Float[Array, " P"]) -> GroupedModel:
    """Return the model linearised about z."""
    observations = problem.observations
    predicted, push = jax.linearize(lambda point: predict(problem, point), z)
    # One direction after the other: all at once, their values leave the cache of a core, which takes twice the time.
    packed = jax.lax.map(push, problem.sparsity.seeds)
    weight = by_group(index, observations.weight)
    jacobian = by_group(index, packed.T) * weight[..., None]
    jacobian = jnp.where((index.columns < z.shape[0])[:, None, :], jacobian, 0.0)
    misfit = by_group(index, observations.weight * (observations.value - predicted))
    median = jnp.zeros(len(problem.hyper_priors.order))
    variance = by_group(index, entry_variances(problem, median), 1.0)
    relative = variance / variance[:, :1]
    return GroupedModel(z, jacobian, misfit, weight, relative, moments_of(jacobian, misfit, weight, relative))


def moments_of(packed: Array, misfit: Array, weight: Array, variance: Array) -> Moments:
    """Return the moments of readings with given variances, all by group."""
    precision = weight / variance
    scaled = packed * precision[..., None]
    return Moments(
        gram=jnp.einsum("gmk,gml->gkl", scaled, packed),
        along=scaled.sum(axis=1),
        pulled=jnp.einsum("gmk,gm->gk", scaled, misfit),
        mean=jnp.sum(precision * misfit, axis=1),
        square=jnp.sum(precision * misfit**2, axis=1),
        information=precision.sum(axis=1),
        log_variance=jnp.sum(weight * jnp.log(variance), axis=1),
    )


def with_misfit(model: GroupedModel, z: Float[Array, " P"], misfit: Float[Array, "G M"]) -> GroupedModel:
    """Return the model about another point with the Jacobian as it is."""
    known, precision = model.moments, model.weight / model.relative
    scaled = model.packed * precision[..., None]
    moments = eqx.tree_at(
        lambda m: (m.pulled, m.mean, m.square),
        known,
        (
            jnp.sum(scaled * misfit[..., None], axis=1),
            jnp.sum(precision * misfit, axis=1),
            jnp.sum(precision * misfit**2, axis=1),
        ),
    )
    return eqx.tree_at(lambda m: (m.z, m.misfit, m.moments), model, (z, misfit, moments))


def entry_variances(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " E"]:
    """Return the variance of every reading at hyperparameters h, without what a run shares."""
    return _variances(problem.noise, problem.hyper_priors.values(h), problem.observations.entry)


_compiled_variances = kept(entry_variances)


def _variances(layers: Sequence[NoiseLayer], values: Array, entry: Entry) -> Array:
    own = jnp.zeros_like(entry.rate)
    for layer in layers:
        if issubclass(layer.noise, EntryNoise):
            own = own + layer.entry_variances(values, entry)
    return own


def group_variances(problem: Problem, index: GroupIndex, h: Float[Array, " H"]) -> tuple[Array, Array]:
    """Return the variance of the first reading of each group, and the variance that the group shares, (G,) each."""
    values = problem.hyper_priors.values(h)
    first = jax.tree.map(lambda leaf: take(leaf, index.first), problem.observations.entry)
    chosen = [
        NoiseLayer(
            layer.noise,
            {name: take(place, index.first) for name, place in layer.places.items()},
            take(layer.acts, index.first),
        )
        for layer in problem.noise
        if issubclass(layer.noise, EntryNoise)
    ]
    shared = jnp.zeros(index.first.shape[0])
    for layer in problem.noise:
        if issubclass(layer.noise, SharedNoise):
            shared = shared + layer.shared_variances(values)
    return _variances(chosen, values, first), shared


def moments_at(problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]) -> Moments:
    """Return the moments at hyperparameters h, without what a run shares."""
    if not index.proportional:
        variance = by_group(index, entry_variances(problem, h), 1.0)
        return moments_of(model.packed, model.misfit, model.weight, variance)
    scale, known = group_variances(problem, index, h)[0], model.moments
    count = model.weight.sum(axis=1)
    return Moments(
        gram=known.gram / scale[:, None, None],
        along=known.along / scale[:, None],
        pulled=known.pulled / scale[:, None],
        mean=known.mean / scale,
        square=known.square / scale,
        information=known.information / scale,
        log_variance=known.log_variance + count * jnp.log(scale),
    )


class NormalEquations(eqx.Module):
    """The log density about z at given h: precision (P, P) and gradient (P,) of z, value, log det Σ, all with prior."""

    precision: Float[Array, "P P"]
    gradient: Float[Array, " P"]
    square: Scalar
    log_determinant: Scalar


def normal_equations(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]
) -> NormalEquations:
    """Return the normal equations at hyperparameters h; `square` is −2 log density up to what depends on h alone."""
    known, size = moments_at(problem, index, model, h), model.z.shape[0]
    shared = group_variances(problem, index, h)[1]
    gain = 1 + shared * known.information
    drawn = shared / gain
    gram = known.gram - drawn[:, None, None] * known.along[:, :, None] * known.along[:, None, :]
    pulled = known.pulled - (drawn * known.mean)[:, None] * known.along
    precision, gradient = scattered(index, gram, size), scattered_vector(index, pulled, size)
    widths = prior_widths(problem, h) ** -2
    square = jnp.sum(known.square - drawn * known.mean**2) + jnp.sum(widths * model.z**2)
    log_determinant = jnp.sum(known.log_variance + jnp.log(gain)) - jnp.sum(jnp.log(widths))
    return NormalEquations(precision + jnp.diag(widths), gradient - widths * model.z, square, log_determinant)


def scattered(index: GroupIndex, blocks: Float[Array, "G K K"], size: int) -> Float[Array, "P P"]:
    """Return the sum of blocks at the places of their parameters."""
    flat = index.patterns[:, :, None] * (size + 1) + index.patterns[:, None, :]
    parts = _by_pattern(index, blocks).reshape(-1)
    total = jnp.zeros((size + 1) ** 2).at[flat.reshape(-1)].add(parts, mode="promise_in_bounds")
    return total.reshape(size + 1, size + 1)[:size, :size]


def scattered_vector(index: GroupIndex, parts: Float[Array, "G K"], size: int) -> Float[Array, " P"]:
    """Return the sum of parts at the places of their parameters."""
    same = _by_pattern(index, parts).reshape(-1)
    total = jnp.zeros(size + 1).at[index.patterns.reshape(-1)].add(same, mode="promise_in_bounds")
    return total[:size]


def _by_pattern(index: GroupIndex, parts: Float[Array, "G *K"]) -> Float[Array, "U *K"]:
    """Return sums over groups of the same parameters: rows are added fast, single places are scattered to slowly."""
    padded = jnp.concatenate([parts, jnp.zeros((1, *parts.shape[1:]))])
    return take(padded, index.alike).sum(axis=1)


def expected_information(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]
) -> Float[Array, "H H"]:
    """Return the Fisher information of the noise scales, prior included, as if the parameters were known.

    The covariance of a group of n readings of variance v that share the variance T has the eigenvalues v, n − 1 times,
    and v + n T.
    """

    def logarithms(h):
        scale, shared = group_variances(problem, index, h)
        return jnp.concatenate([jnp.log(scale), jnp.log(scale + count * shared), 2 * jnp.log(prior_widths(problem, h))])

    count = model.weight.sum(axis=1)
    slope = jax.jacfwd(logarithms)(h)
    inner, outer = jnp.maximum(count - 1.0, 0.0), jnp.where(count > 0, 1.0, 0.0)
    weight = 0.5 * jnp.concatenate([inner, outer, jnp.ones(slope.shape[0] - 2 * len(count))])
    return slope.T @ (weight[:, None] * slope) + jnp.eye(h.shape[0])


def log_marginal_of(problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]) -> Scalar:
    """Return log p(y, h) with the parameters integrated out of the linearised model."""
    known = normal_equations(problem, index, model, h)
    factor = jnp.linalg.cholesky(known.precision)
    half = jax.scipy.linalg.solve_triangular(factor, known.gradient, lower=True)
    readings = jnp.sum(problem.observations.weight)
    constant = 0.5 * jnp.log(2 * jnp.pi) * (readings + h.shape[0])
    fit = -0.5 * known.square + 0.5 * half @ half - 0.5 * jnp.sum(h**2)
    return fit - jnp.sum(jnp.log(jnp.diagonal(factor))) - 0.5 * known.log_determinant - constant


def marginal_slope(
    problem: Problem, index: GroupIndex, model: GroupedModel, h: Float[Array, " H"]
) -> tuple[Scalar, Float[Array, " H"]]:
    """Return log p(y, h) with the parameters integrated out of the linearised model, and its gradient by h."""
    if not index.proportional:
        return jax.value_and_grad(lambda point: log_marginal_of(problem, index, model, point))(h)
    (variance, shared), of_variances = jax.vjp(lambda point: group_variances(problem, index, point), h)
    widths, of_widths = jax.vjp(lambda point: prior_widths(problem, point) ** -2, h)
    known, size = model.moments, model.z.shape[0]
    count, n, along = model.weight.sum(axis=1), known.information, known.along
    total = variance + shared * n
    kappa = shared / (variance * total)
    gram = known.gram / variance[:, None, None] - kappa[:, None, None] * along[:, :, None] * along[:, None, :]
    pulled = known.pulled / variance[:, None] - (kappa * known.mean)[:, None] * along
    precision = scattered(index, gram, size) + jnp.diag(widths)
    gradient = scattered_vector(index, pulled, size) - widths * model.z
    factor = jnp.linalg.cholesky(precision)
    root = jax.scipy.linalg.solve_triangular(factor, jnp.eye(size), lower=True)
    half = root @ gradient
    step, inverse = root.T @ half, root.T @ root

    square = jnp.sum(known.square / variance - kappa * known.mean**2) + jnp.sum(widths * model.z**2)
    log_determinant = jnp.sum(known.log_variance + count * jnp.log(variance) + jnp.log(total / variance))
    constant = 0.5 * jnp.log(2 * jnp.pi) * (jnp.sum(problem.observations.weight) + h.shape[0])
    value = (
        -0.5 * square + 0.5 * half @ half - 0.5 * h @ h - jnp.sum(jnp.log(jnp.diagonal(factor)))
        - 0.5 * (log_determinant - jnp.sum(jnp.log(widths))) - constant
    )  # fmt: skip

    ahead = take(jnp.concatenate([step, jnp.zeros(1)]), index.columns)
    misfit = known.mean - jnp.sum(along * ahead, axis=1)
    # Sums of products and no `einsum`, which XLA computes for small blocks at four times the cost.
    blocks = _blocks(index, inverse)
    moment = blocks + ahead[:, :, None] * ahead[:, None, :]
    square_mean = known.square - 2 * jnp.sum(ahead * known.pulled, axis=1) + jnp.sum(known.gram * moment, axis=(1, 2))
    mean_square = misfit**2 + jnp.sum(blocks * along[:, :, None] * along[:, None, :], axis=(1, 2))
    twice = 2 * kappa / variance - kappa**2 * n
    by_variance = square_mean / variance**2 - twice * mean_square
    by_variance = 0.5 * (by_variance - count / variance + kappa * n)
    by_shared = 0.5 * (mean_square / total**2 - n / total)
    by_widths = 0.5 * (1 / widths - (model.z + step) ** 2 - jnp.diagonal(inverse))
    return value, of_variances((by_variance, by_shared))[0] + of_widths(by_widths)[0] - h


def _blocks(index: GroupIndex, inverse: Float[Array, "P P"]) -> Float[Array, "G K K"]:
    """Return the block of each group of a matrix, 0 if a group has no parameter."""
    padded = jnp.pad(inverse, (0, 1))
    flat = index.patterns[:, :, None] * padded.shape[0] + index.patterns[:, None, :]
    return take(take(padded.reshape(-1), flat), index.pattern)
