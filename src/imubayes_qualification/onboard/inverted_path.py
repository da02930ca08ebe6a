"""The signal path inverted: rate and specific force from the outputs of a unit.

Rate and specific force of the body follow from the outputs of all channels at once.  For one row the signal path y =
f(u) of the warmed-up unit is solved for u = (rate, specific force) by Gauss–Newton steps, weighted by the noise: u ← u
+ H (y − f(u)) with H = (JᵀWJ)⁻¹JᵀW, J = ∂f/∂u.  The path is linear to parts in a thousand, so each step gains three
digits.  The uncertainty of u has two sources: an error δθ of the parameters moves the solution by −H (∂f/∂θ) δθ; the
noise of the outputs moves it by H ε.

The path is also inverted along the input axis of every channel.  At rest, with the input along the channel's own axis
alone, the output is a function of the input and of the temperatures of sensor and converter.  It is inverted by
Newton's method from the nominal scale, which squares the error, at least three digits at a time.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp

from imubayes.compiled.kept_programs import kept
from imubayes.foundations.arrays import Array, Bool, Float, Int, Scalar
from imubayes.model.sensitive_axes import SensitivityInputs, acting_on, outputs_at, outputs_in_body

_ITERATIONS = 6


class RowSolution(eqx.Module):
    """The inputs of R rows, n of the six components of rate and specific force.

    Attributes
    ----------
    inputs : shape (R, n), rad/s and m/s².
    step : shape (R, n), the last correction: how far the iteration still moved.
    by_parameters : shape (R, n, K), standard deviations that the independent causes of the parameters' error give.
    gain : shape (R, n, C), H: inputs per output.
    """

    inputs: Float[Array, "R n"]
    step: Float[Array, "R n"]
    by_parameters: Float[Array, "R n K"]
    gain: Float[Array, "R n C"]


@kept
def solve_rows(
    inputs: SensitivityInputs,
    values: Float[Array, " V"],
    places: Int[Array, " A"],
    factor: Float[Array, "A K"],
    kinds: tuple[str, ...],
    outputs: Float[Array, "R C"],
    weights: Float[Array, "R C"],
    temperatures: Float[Array, "R 2"],
) -> RowSolution:
    """Return what the body experienced in every row.

    Parameters
    ----------
    values : all values the layers refer to, SI.
    places, factor : the uncertain ones among them, and a factor L of their covariance L Lᵀ.
    kinds : kinds of channels that are read; what the other kind would measure is taken as zero.
    outputs : of the channels of these kinds, one kind after the other, output units.
    weights : inverse variances of the outputs.
    temperatures : of sensor and converter, °C.
    """
    unknown = unknowns(kinds)

    def predicted(changed, acting, at):
        stimulus = jnp.zeros(6).at[unknown].set(acting)
        found = outputs_in_body(inputs, changed, stimulus, {"temperature": at[0], "converter_temperature": at[1]})
        return jnp.concatenate([found[kind] for kind in kinds])

    def of_row(read, weight, at):
        def gain_at(acting):
            slope = jax.jacfwd(lambda u: predicted(values, u, at))(acting)
            weighted = slope.T * weight[None, :]
            return jnp.linalg.solve(weighted @ slope, weighted)

        def improved(_, state):
            acting, _ = state
            step = gain_at(acting) @ (read - predicted(values, acting, at))
            return acting + step, step

        start = jnp.zeros(len(unknown))
        acting, step = jax.lax.fori_loop(0, _ITERATIONS, improved, (start, start))
        gain = gain_at(acting)
        moved = jax.jacfwd(lambda c: predicted(jnp.asarray(values).at[places].add(factor @ c), acting, at))(
            jnp.zeros(factor.shape[1])
        )
        return acting, step, -gain @ moved, gain

    return RowSolution(*jax.vmap(of_row)(outputs, weights, temperatures))


def unknowns(kinds: tuple[str, ...]) -> Int[Array, " n"]:
    """Return which components of (rate, specific force) the channels of some kinds determine, shape (n,)."""
    chosen: Bool[Array, " 6"] = jnp.array(["gyro" in kinds] * 3 + ["accelerometer" in kinds] * 3)
    return jnp.flatnonzero(chosen, size=3 * len(kinds))


def outputs_of(
    inputs: SensitivityInputs, values: Float[Array, " V"], acting: dict[str, Float[Array, " C"]],
    ambient: Mapping[str, Scalar],
) -> dict[str, Float[Array, " C"]]:  # fmt: skip
    """Return the outputs at inputs along the axes of the channels, kind → (C,), rad/s or m/s² → output units."""
    experience = {}
    for kind, known in inputs.channels.items():
        along = acting[kind][:, None] * known.axes[:, 0]
        zero = jnp.zeros_like(along)
        experience[kind] = acting_on(*((along, zero) if kind == "gyro" else (zero, along)))
    return outputs_at(inputs, values, experience, ambient)


def inputs_of(
    inputs: SensitivityInputs,
    values: Float[Array, " V"],
    outputs: dict[str, Float[Array, " C"]],
    ambient: Mapping[str, Scalar],
) -> dict[str, Float[Array, " C"]]:
    """Return the inputs along the axes of the channels that give these outputs, kind → (C,), rad/s or m/s²."""

    def improved(_, acting):
        ones = jax.tree.map(jnp.ones_like, acting)
        found, slope = jax.jvp(lambda each: outputs_of(inputs, values, each, ambient), (acting,), (ones,))
        return {kind: acting[kind] + (outputs[kind] - found[kind]) / slope[kind] for kind in acting}

    nominal = {kind: (outputs[kind] - known.offset) / known.scale for kind, known in inputs.channels.items()}
    return jax.lax.fori_loop(0, _ITERATIONS, improved, nominal)
