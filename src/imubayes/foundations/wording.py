"""Numbers with their nouns and verbs, in the singular and in the plural."""


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural if it has to be: `1 effect`, `2 effects`, `3 quantities`.

    Of several words the last one is the noun.
    """
    if number == 1:
        return f"{number} {noun}"
    consonant = noun.endswith("y") and not noun.endswith(("ay", "ey", "oy"))
    return f"{number} {noun[:-1]}ies" if consonant else f"{number} {noun}s"


def agreeing(number: int, one: str, several: str) -> str:
    """Return the verb or pronoun that agrees with a number: `agreeing(1, "is", "are")` is `is`."""
    return one if number == 1 else several
