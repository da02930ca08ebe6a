"""The four-part error."""

from imubayes.foundations.errors import InputError, Issue, closest_first


def test_a_problem_has_four_parts_in_order():
    text = str(Issue("it is wrong", "file, line 2", "this, that", "mend it"))
    assert text.splitlines() == [
        "error: it is wrong",
        "  where:   file, line 2",
        "  allowed: this, that",
        "  do:      mend it",
    ]


def test_where_nothing_can_be_listed_the_part_is_left_out():
    assert "allowed" not in str(Issue("it is wrong", "file", "", "mend it"))


def test_all_problems_are_reported_together():
    problems = [Issue(f"fault {i}", "file", "", "mend it") for i in range(3)]
    error = InputError(problems)
    assert error.issues == tuple(problems)
    assert str(error).count("error: ") == 3
    assert InputError(problems[0]).issues == (problems[0],)


def test_the_closest_come_first_and_a_long_list_is_cut():
    options = ["gyro_bias", "gyro_scale_factor", "accel_bias"]
    assert closest_first("gyro_bais", options).startswith("gyro_bias")
    assert closest_first("zzz", [f"name{i}" for i in range(20)]).endswith(", …")
    assert closest_first("a", []) == ""
