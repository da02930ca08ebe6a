"""User-defined effects, evaluated abstractly: by shapes and types alone, before anything is fitted."""

import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp

from imubayes.foundations.errors import input_error
from imubayes.model.bound_effects import BoundEffect
from imubayes.model.likelihood import log_density
from imubayes.model.model_file import ModelSpec
from imubayes.model.problem import Problem, signal_path, values_of


def dry_run(problem: Problem, effects: Sequence[BoundEffect], spec: ModelSpec) -> None:
    """Trace the signal path and the log density without computing them.

    Parameters
    ----------
    problem, effects : the model with the user's effects.
    spec : names the files, or the classes, that define these.

    Raises
    ------
    InputError
        if a user-defined class raises, or does not return one real number; names file, line and cause.
    """
    files = spec.files
    own = [effect.effect_class for effect in effects if effect.effect_class in spec.classes or _is_own(effect, files)]
    if not own:
        return
    try:
        path = jax.eval_shape(lambda z: signal_path(problem, values_of(problem, z)), _like(problem.size[0]))
        nodes = len(problem.nodes.stand)
        for kind, channels in problem.channels.items():
            found, wanted = path.signal[kind], (nodes, len(channels.scale))
            if found.shape != wanted or not jnp.issubdtype(found.dtype, jnp.floating):
                raise TypeError(f"the signal of a sample must be one real number, not {found.dtype}{found.shape[2:]}")
        jax.eval_shape(lambda z, h: log_density(problem, z, h), *map(_like, problem.size))
    except (Exception, SystemExit) as error:
        line = _line(error, files)
        names = ", ".join(member.__name__ for member in own)
        raise input_error(
            f"an effect of your own cannot be evaluated: {type(error).__name__}: {_short(error)}",
            line or f"{', '.join(files) or 'class'}: {names}",
            "methods as their base class describes them, written with jax.numpy for one sample; each returns its first "
            "argument, changed",
            "correct the class; a choice that depends on a value is jnp.where, not if",
        ) from error


def _like(size: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((size,), jnp.zeros(0).dtype)


def _is_own(effect: BoundEffect, files: Sequence[str]) -> bool:
    module = getattr(sys.modules.get(effect.effect_class.__module__), "__file__", None)
    return module is not None and any(Path(module) == Path(file) for file in files)


def _line(error: BaseException, files: Sequence[str]) -> str:
    """Return file, line and method of the last step in a file of the user; empty if there is none."""
    own = {str(Path(file).resolve()) for file in files}
    steps = [frame for frame in traceback.extract_tb(error.__traceback__) if str(Path(frame.filename).resolve()) in own]
    return f"{steps[-1].filename}:{steps[-1].lineno}, in {steps[-1].name}" if steps else ""


def _short(error: BaseException) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else "no message"
