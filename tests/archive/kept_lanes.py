"""Run a function of units in lanes twice, the second time as another process would: `kept_lanes.py FOLDER`.

A process of its own, since the tests check types, in wrappers that have no identity.
"""

import sys
from pathlib import Path

import jax
import numpy as np

from imubayes.campaign import load_campaign
from imubayes.compiled import kept_programs
from imubayes.model.model_file import read_model
from imubayes_archive.unit_fits.fit_unit import bound_to
from imubayes_archive.unit_fits.group_moments import grouped_model
from imubayes_archive.unit_fits.lanes import LANES, LaneStructure

ROOT = Path(__file__).parents[2]

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    campaign = load_campaign(ROOT / "data" / "polar-tumble")
    model = bound_to(read_model(ROOT / "models" / "polar-tumble.toml"), campaign)
    kept_programs.keep_programs(Path(sys.argv[1]))
    for _ in range(2):
        kept_programs.forget_programs()
        structure = LaneStructure.of(model.problem)
        assert structure is not None
        middle = np.zeros((LANES, structure.problem.size[0]))
        found = structure.run(grouped_model, structure.stacked([model]), middle)
        print(*(np.asarray(leaf).tobytes().hex() for leaf in jax.tree.leaves(found)))
        vars(kept_programs)["_compiled"] = None  # nothing is traced again
