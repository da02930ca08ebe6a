"""Numbers agree with their nouns and verbs."""

import pytest

from imubayes.foundations.wording import agreeing, counted


@pytest.mark.parametrize(
    ("number", "noun", "said"),
    [
        (1, "effect", "1 effect"), (0, "effect", "0 effects"), (2, "effect", "2 effects"),
        (3, "quantity", "3 quantities"), (1, "quantity", "1 quantity"), (2, "day", "2 days"),
        (2, "nuisance parameter", "2 nuisance parameters"),
    ],
)  # fmt: skip
def test_a_noun_is_in_the_plural_where_it_has_to_be(number, noun, said):
    assert counted(number, noun) == said


def test_a_verb_agrees_with_its_number():
    assert [agreeing(number, "is", "are") for number in (0, 1, 2)] == ["are", "is", "are"]
