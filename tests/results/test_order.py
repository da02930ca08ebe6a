"""The order in which a campaign states its runs, channels, mountings and tables moves no number."""

import shutil
from pathlib import Path

import pytest
import tomlkit

import imubayes

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_a_campaign_stated_in_reverse_gives_the_same_posterior(tmp_path):
    turned = tmp_path / "turned"
    shutil.copytree(ROOT / "data" / "hidden-gyro", turned)
    stated = tomlkit.parse((turned / "campaign.toml").read_text()).unwrap()
    stated |= {part: stated[part][::-1] for part in ("run", "channel", "mounting", "table")}
    (turned / "campaign.toml").write_text(tomlkit.dumps(stated))
    model = ROOT / "models" / "hidden-effects.toml"
    here, there = (imubayes.fit(data, model, sample=False) for data in (ROOT / "data" / "hidden-gyro", turned))
    names = [entry.name for entry in (*here.summary.parameters, *here.summary.derived)]
    assert sorted(names) == sorted(entry.name for entry in (*there.summary.parameters, *there.summary.derived))
    for name in names:
        assert there[name].mean == pytest.approx(here[name].mean, abs=0.001 * here[name].sd), name
        assert there[name].sd == pytest.approx(here[name].sd, rel=0.001), name
