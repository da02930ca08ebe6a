"""The problem as a pure function of arrays: parameters in, whitened residuals and log density out.

A `Problem` is one pytree: the nominal motion, the layers of the signal path, the measured entries, the noise, the
priors.  Nothing here closes over a campaign, so units of equal structure are stacked and treated in one vmap.

With θ in z (prior: standard normal) and hyperparameters h in z, the log density is
−½ |r|² − ½ log det Σ(h) + const with r = [L⁻¹(y − f(θ)), (z_θ)/s(h), z_h]: Σ = D^½ R D^½ + Σ_g T_g 1 1ᵀ (see
`imubayes.noise.base`), R = I unless a member correlates, and s(h) is 1 except for parameters whose prior width is
itself learnt.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.model.closure import Transitions, closing_rotations
from imubayes.model.forward import Channels, Layer, start, travel
from imubayes.model.servo import Servos, servo_angles
from imubayes.noise.base import Entry, EntryNoise, Noise, SeriesNoise, SharedNoise
from imubayes.parameters.vector import Priors
from imubayes.stimulus import Instants, SignalPath
from imubayes.types import Array, Bool, Float, Int, Scalar


class NoiseLayer(eqx.Module):
    """A noise member with the places of its values: one per entry, or per run and channel for what is shared.

    `acts` is 1 where the member applies and 0 elsewhere.
    """

    noise: type[Noise] = eqx.field(static=True)
    places: dict[str, Array]
    acts: Float[Array, " M"]

    def correlations(self, h: Float[Array, " H"]) -> Float[Array, " M"]:
        """Return the correlation of neighbouring rows of every run and channel."""
        chosen = {field: h[place] for field, place in self.places.items()}
        return self.acts * jax.vmap(lambda one: self.noise(**one).of_neighbours())(chosen)  # pyright: ignore

    def variances(self, h: Float[Array, " H"], entries: Entry | None) -> Float[Array, " M"]:
        """Return the variance of every entry, or of every run and channel."""
        chosen = {field: h[place] for field, place in self.places.items()}
        if entries is not None:
            found = jax.vmap(lambda one, entry: self.noise(**one).variance(entry))(chosen, entries)  # pyright: ignore
        else:
            found = jax.vmap(lambda one: self.noise(**one).shared_variance())(chosen)  # pyright: ignore
        return self.acts * found


class Observations(eqx.Module):
    """What was measured (E entries in G groups, a group being one run and channel).

    Attributes
    ----------
    value : shape (E,), output units; 0 for closing rotations, rad.
    weight : shape (E,), 1, or 0 for an entry that is masked out.
    entry : facts about each entry.
    readout : shape (E_r,), place of each entry in the flattened outputs; closing rotations follow after these.
    group : shape (E,), group of each entry.
    members : shape (G, M), entries of each group, E where padded.
    in_time : shape (G, M), the same in the order of time.
    rank : shape (E,), the place of an entry's row in the order of time of its run.
    """

    value: Float[Array, " E"]
    weight: Float[Array, " E"]
    entry: Entry
    readout: Int[Array, " Er"]
    group: Int[Array, " E"]
    members: Int[Array, "G M"]
    in_time: Int[Array, "G M"]
    rank: Int[Array, " E"]


class Sparsity(eqx.Module):
    """Which entries a parameter can reach; parameters of one colour reach no entry together.

    Attributes
    ----------
    colour : shape (P,).
    reach : shape (E, P), bool.
    seeds : shape (colours, P), 0 or 1.
    """

    colour: Int[Array, " P"]
    reach: Bool[Array, "E P"]
    seeds: Float[Array, "K P"]


class Problem(eqx.Module):
    """Everything the inference needs, as arrays.

    Attributes
    ----------
    instants, channels, layers, transitions, servos : the forward model.
    turns : rows as (number of rows, nodes per row), in the order of the nodes; static.
    node_weight : shape (N,).
    nulls : shape (V − P,), the values behind the parameters at which effects do nothing.
    priors, hyper_priors : from z to SI values, θ and h.
    spread_of : shape (P,), place in h of the parameter's learnt prior width, H where the prior is fixed.
    spread_unit : shape (P,), width of the parameter's own prior, SI.
    """

    instants: Instants
    channels: dict[str, Channels]
    layers: tuple[Layer, ...]
    transitions: Transitions | None
    servos: Servos | None
    turns: tuple[tuple[int, int], ...] = eqx.field(static=True)
    node_weight: Float[Array, " N"]
    nulls: Float[Array, " nulls"]
    priors: Priors
    hyper_priors: Priors
    noise: tuple[NoiseLayer, ...]
    observations: Observations
    sparsity: Sparsity
    spread_of: Int[Array, " P"]
    spread_unit: Float[Array, " P"]

    @property
    def size(self) -> tuple[int, int]:
        """Number of parameters and of hyperparameters."""
        return self.spread_of.shape[-1], len(self.hyper_priors.order)


def values_of(problem: Problem, z: Float[Array, " P"]) -> Float[Array, " V"]:
    """Return all values the layers refer to: parameters in SI, then nulls."""
    return jnp.concatenate([problem.priors.values(z), problem.nulls])


def signal_path(problem: Problem, values: Float[Array, " V"]) -> SignalPath:
    """Return the signal path at every node, for parameters in SI and nulls."""
    return travel(problem.layers, start(problem.instants), values)


def predict(problem: Problem, z: Float[Array, " P"]) -> Float[Array, " E"]:
    """Return the predicted value of every entry, output units (rad for closing rotations)."""
    return predict_from(problem, values_of(problem, z))


# Traced once for all that is built on it, whatever derivative is taken of it.
@jax.jit
def predict_from(problem: Problem, values: Float[Array, " V"]) -> Float[Array, " E"]:
    """Return what `predict` does, from parameters in SI and nulls."""
    path = signal_path(problem, values)
    outputs = [row_means(problem, path.signal[kind]).reshape(-1) for kind in sorted(problem.channels)]
    if problem.servos is not None:
        angles = servo_angles(problem.servos, problem.layers, problem.instants, problem.channels, values)
        outputs.append(jnp.degrees(angles).reshape(-1))
    predicted = jnp.concatenate(outputs)[problem.observations.readout]
    if problem.transitions is None:
        return predicted
    closing = closing_rotations(problem.transitions, problem.channels, path.motion, values)
    return jnp.concatenate([predicted, closing.reshape(-1)])


def row_means(problem: Problem, signal: Float[Array, "N C"]) -> Float[Array, "R C"]:
    """Average the nodes of each row; rows come sorted by their number of nodes, so this is a reshape and a sum."""
    weighted = signal * problem.node_weight[:, None]
    means, place = [], 0
    for rows, nodes in problem.turns:
        block = weighted[place : place + rows * nodes]
        means.append(block.reshape(rows, nodes, -1).sum(axis=1))
        place += rows * nodes
    return jnp.concatenate(means)


class Series(eqx.Module):
    """The root A of R⁻¹, R = AR(1) along each group: (A x)_k = (x_k − ρ_k x_(k−1))/√(1 − ρ_k²).

    Attributes
    ----------
    before : shape (E,), the entry before in the same group that is not masked, E where there is none.
    correlation : shape (E,), ρ with that entry, 0 where there is none.
    """

    before: Int[Array, " E"]
    correlation: Float[Array, " E"]

    def forward(self, x: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return A x."""
        gain, carried = self._factors(x.ndim)
        return gain * x - carried * jnp.concatenate([x, jnp.zeros((1, *x.shape[1:]))])[self.before]

    def back(self, x: Float[Array, " E"]) -> Float[Array, " E"]:
        """Return Aᵀ x."""
        gain, carried = self._factors(1)
        return gain * x - jnp.zeros(len(x) + 1).at[self.before].add(carried * x)[:-1]

    def diagonal(self) -> Float[Array, " E"]:
        """Return the diagonal of AᵀA = R⁻¹."""
        gain, carried = self._factors(1)
        return gain**2 + jnp.zeros(len(gain) + 1).at[self.before].add(carried**2)[:-1]

    def _factors(self, dimensions: int):
        gain = 1 / jnp.sqrt(1 - self.correlation**2)
        shape = (-1, *(1,) * (dimensions - 1))
        return gain.reshape(shape), (gain * self.correlation).reshape(shape)


class Whitener(eqx.Module):
    """Σ(h)^(−½) of the data, in closed form, and its log determinant.

    Attributes
    ----------
    precision_root : shape (E,), D^(−½), 0 where masked.
    shrink : shape (G,), what the shared part takes off along each group's direction.
    log_determinant : log det Σ.
    series : the correlation in time; None in a model without.
    """

    precision_root: Float[Array, " E"]
    shrink: Float[Array, " G"]
    log_determinant: Scalar
    series: Series | None

    @property
    def direction(self) -> Float[Array, " E"]:
        """What the entries of a group have in common, scaled: u = A D^(−½) 1."""
        return self.precision_root if self.series is None else self.series.forward(self.precision_root)

    def scale(self, values: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
        """Return A D^(−½) · values."""
        root = self.precision_root if values.ndim == 1 else self.precision_root[:, None]
        return root * values if self.series is None else self.series.forward(root * values)


def _group_sum(values: Float[Array, "E *columns"], observations: Observations) -> Float[Array, "G *columns"]:
    padded = jnp.concatenate([values, jnp.zeros((1, *values.shape[1:]))])
    return padded[observations.members].sum(axis=1)


def whitener(problem: Problem, h: Float[Array, " H"]) -> Whitener:
    """Return the whitener at hyperparameters h (in z).

    The inverse of D + T 1 1ᵀ with u = D^(−½) 1 has the root (I − κ û ûᵀ) D^(−½), κ = 1 − 1/√(1 + T |u|²); with rows
    that are correlated u = A D^(−½) 1 and the root is (I − κ û ûᵀ) A D^(−½), AᵀA = R⁻¹.
    """
    values = problem.hyper_priors.values(h)
    observations = problem.observations
    diagonal = jnp.zeros_like(observations.value)
    shared = jnp.zeros(observations.members.shape[0])
    for layer in problem.noise:
        if issubclass(layer.noise, EntryNoise):
            diagonal = diagonal + layer.variances(values, observations.entry)
        elif issubclass(layer.noise, SharedNoise):
            shared = shared + layer.variances(values, None)
    root = observations.weight / jnp.sqrt(diagonal)
    series = _series(problem, values)
    along = root if series is None else series.forward(root)
    direction = _group_sum(along**2, observations)
    gain = 1 + shared * direction
    safe = jnp.where(direction > 0, direction, 1.0)
    shrink = (1 - 1 / jnp.sqrt(gain)) / safe
    log_determinant = jnp.sum(observations.weight * jnp.log(diagonal)) + jnp.sum(jnp.log(gain))
    if series is not None:
        log_determinant = log_determinant + jnp.sum(observations.weight * jnp.log1p(-(series.correlation**2)))
    return Whitener(root, shrink, log_determinant, series)


def _series(problem: Problem, values: Float[Array, " H"]) -> Series | None:
    """Return each entry's correlation with the one before it that is not masked; None where nothing correlates."""
    layers = [layer for layer in problem.noise if issubclass(layer.noise, SeriesNoise)]
    if not layers:
        return None
    observations = problem.observations
    groups, most = observations.in_time.shape
    none = len(observations.value)
    seen = jnp.concatenate([observations.weight > 0, jnp.zeros(1, dtype=bool)])[observations.in_time]
    last = jax.lax.cummax(jnp.where(seen, jnp.arange(most)[None, :], -1), axis=1)
    last = jnp.concatenate([jnp.full((groups, 1), -1), last[:, :-1]], axis=1)
    entry = jnp.where(last < 0, none, jnp.take_along_axis(observations.in_time, jnp.maximum(last, 0), axis=1))
    before = jnp.full(none + 1, none).at[observations.in_time].set(entry)[:-1]
    before = jnp.where(observations.weight > 0, before, none)
    apart = (
        observations.rank - jnp.concatenate([observations.rank, jnp.zeros(1, dtype=observations.rank.dtype)])[before]
    )
    one_row = jnp.zeros(groups)
    for layer in layers:
        one_row = one_row + layer.correlations(values)
    linked = before < none
    steps = jnp.where(linked, apart, 1).astype(float)
    return Series(before, jnp.where(linked, one_row[observations.group] ** steps, 0.0))


def whiten(problem: Problem, by: Whitener, residual: Float[Array, "E *columns"]) -> Float[Array, "E *columns"]:
    """Return Σ^(−½) · residual, of one or of many columns."""
    columns = (-1, *(1,) * (residual.ndim - 1))
    scaled, direction = by.scale(residual), by.direction.reshape(columns)
    along = _group_sum(direction * scaled, problem.observations)
    return scaled - direction * (by.shrink.reshape(columns) * along)[problem.observations.group]


def prior_widths(problem: Problem, h: Float[Array, " H"]) -> Float[Array, " P"]:
    """Return the standard deviation of each z_θ: 1, or what has been learnt of the spread."""
    values = problem.hyper_priors.values(h)
    widths = jnp.concatenate([values, jnp.ones(1)])[problem.spread_of]
    return jnp.where(problem.spread_of < values.shape[0], widths / problem.spread_unit, 1.0)


def residuals(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Float[Array, " EP"]:
    """Return [L⁻¹(y − f(θ)), z_θ/s(h)]: half its squared norm is what a fit at given h minimises."""
    data = whiten(problem, whitener(problem, h), problem.observations.value - predict(problem, z))
    return jnp.concatenate([data, z / prior_widths(problem, h)])


def log_normaliser(problem: Problem, h: Float[Array, " H"]) -> Scalar:
    """Return the part of the log density that depends on h alone, its prior included."""
    by = whitener(problem, h)
    widths = jnp.sum(jnp.log(prior_widths(problem, h)))
    entries = jnp.sum(problem.observations.weight)
    constant = 0.5 * jnp.log(2 * jnp.pi) * (entries + problem.size[0] + problem.size[1])
    return -0.5 * by.log_determinant - widths - 0.5 * jnp.sum(h**2) - constant


def log_density(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> Scalar:
    """Return the joint log density of data, parameters and hyperparameters, in z."""
    r = residuals(problem, z, h)
    return -0.5 * jnp.sum(r**2) + log_normaliser(problem, h)


def prediction_jacobian(problem: Problem, z: Float[Array, " P"]) -> Float[Array, "E P"]:
    """Return ∂f/∂z.

    One forward derivative per colour instead of one per parameter: parameters of one colour reach no common entry, so
    their columns are told apart by their reach.
    """
    sparsity = problem.sparsity
    _, push = jax.linearize(lambda one: predict(problem, one), z)
    packed = jax.vmap(push)(sparsity.seeds)
    return jnp.where(sparsity.reach, packed[sparsity.colour].T, 0.0)


class EntryLikelihood(eqx.Module):
    """Log likelihood piece by piece.

    Attributes
    ----------
    entry : shape (E,), each entry given all others: log p(y_i | y_−i, θ, h).
    group : shape (G,), each run and channel as a whole.
    """

    entry: Float[Array, " E"]
    group: Float[Array, " G"]


def entry_log_likelihood(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]) -> EntryLikelihood:
    """Return the log likelihood of every entry and of every run and channel.

    Entries of one run share an offset, so an entry's own density is conditional on the others: with Σ⁻¹ = Q its
    variance is 1/Q_ii and its residual (Q r)_i/Q_ii (Bürkner, Gabry, Vehtari, Computational Statistics 2021).
    """
    by, observations = whitener(problem, h), problem.observations
    residual = observations.value - predict(problem, z)
    pulled, precision = inverse_covariance(problem, by, residual)
    safe = jnp.where(observations.weight > 0, precision, 1.0)
    two_pi = jnp.log(2 * jnp.pi)
    entry = observations.weight * 0.5 * (jnp.log(safe) - pulled**2 / safe - two_pi)
    root = jnp.where(observations.weight > 0, by.precision_root, 1.0)
    direction = _group_sum(by.direction**2, observations)
    shrunk = 1 - by.shrink * direction
    log_determinant = -2 * _group_sum(jnp.log(root), observations) - 2 * jnp.log(shrunk)
    if by.series is not None:
        log_determinant = log_determinant + _group_sum(jnp.log1p(-(by.series.correlation**2)), observations)
    count = _group_sum(observations.weight, observations)
    square = _group_sum(residual * pulled, observations)
    return EntryLikelihood(entry, -0.5 * (square + log_determinant + count * two_pi))


def inverse_covariance(problem: Problem, by: Whitener, residual: Float[Array, " E"]):
    """Return Σ⁻¹ · residual and the diagonal of Σ⁻¹, both of shape (E,)."""
    observations = problem.observations
    direction = by.direction
    # (I − κ û ûᵀ)² = I − (2 shrink − shrink² |u|²) u uᵀ, with shrink = κ/|u|²
    rank_one = 2 * by.shrink - by.shrink**2 * _group_sum(direction**2, observations)
    if by.series is not None:
        scaled = by.scale(residual)
        along = _group_sum(direction * scaled, observations)
        pulled = by.series.back(scaled - direction * (rank_one * along)[observations.group])
        shared = rank_one[observations.group] * by.series.back(direction) ** 2
        return by.precision_root * pulled, by.precision_root**2 * (by.series.diagonal() - shared)
    weight = direction**2
    along = _group_sum(weight * residual, observations)
    pulled = weight * (residual - (rank_one * along)[observations.group])
    return pulled, weight * (1 - rank_one[observations.group] * weight)
