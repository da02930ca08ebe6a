"""Numbers of three axes are taken as people write them."""

import pytest

from imubayes.cli.session import numbers_apart


@pytest.mark.parametrize(
    "words",
    [
        ["--gyro-offset", "24800", "40600", "-41140"],
        ["--gyro-offset", "24800,40600,-41140"],
        ["--gyro-offset=[24800,40600,-41140]"],
        ["--gyro-offset", "24800", "--gyro-offset", "40600", "--gyro-offset", "-41140"],
        ["--gyro-offset=24800", "--gyro-offset=40600", "--gyro-offset=-41140"],
    ],
)
@pytest.mark.parametrize("behind", [[], ["log.csv"], ["--serial", "7"]])
def test_three_numbers_after_an_option(words, behind):
    expected = ["--gyro-offset=24800", "--gyro-offset=40600", "--gyro-offset=-41140"]
    assert numbers_apart(["convert", *words, *behind]) == ["convert", *expected, *behind]


@pytest.mark.parametrize(
    "words", [["--gyro-scale"], ["--gyro-scale", "log.csv"], ["--rows", "1", "2"], ["--accel-scale", "x"]]
)
def test_anything_else_stays(words):
    assert numbers_apart(words) == words


def test_a_file_behind_three_numbers_stays_a_file():
    assert numbers_apart(["--accel-scale", "1", "2", "3", "4"]) == [*(f"--accel-scale={n}" for n in "123"), "4"]
