"""The outline of a page of HTML, as a reader who hears it or has no mouse meets it: landmarks, headings, regions."""

from collections import Counter
from html.parser import HTMLParser

LANDMARKS = {"main", "nav", "header", "footer"}
VOID = {"meta", "img", "link", "br", "hr", "input", "col"}


class Outline(HTMLParser):
    """What a page is made of.

    Attributes
    ----------
    headings : levels, in order.
    outside : text of the body that stands in no landmark.
    faults : what somebody who hears the page, or has no mouse, cannot reach.
    """

    def __init__(self, page: str):
        super().__init__()
        self.open = list[str]()
        self.counts, self.names, self.known, self.wanted = Counter[str](), Counter[str](), set[str](), set[str]()
        self.headings, self.outside, self.faults = list[int](), list[str](), list[str]()
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.counts[tag] += 1
        self.known.add(given.get("id", ""))
        if tag == "a":
            self.wanted.add(given["href"].removeprefix("#"))
        if tag in {"h1", "h2", "h3", "h4"}:
            self.headings.append(int(tag[1]))
        if tag == "img" and not given.get("alt"):
            self.faults.append("a picture without words")
        if "scroll" in given.get("class", "").split():
            name = given.get("aria-label") or given.get("aria-labelledby")
            self.names[name or ""] += 1
            if given.get("role") != "region" or given.get("tabindex") != "0" or not name:
                self.faults.append("what scrolls cannot be reached by keys")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if data.strip() and "body" in self.open and not LANDMARKS & set(self.open):
            self.outside.append(data.strip())


def assert_accessible(page: str) -> Outline:
    """One main part, everything in a landmark, headings in order, what scrolls has a name and takes the keys."""
    found = Outline(page)
    assert found.counts["main"] == 1
    assert found.counts["nav"] >= 1
    assert found.outside == []
    assert found.headings[0] == 1
    assert found.headings.count(1) == 1
    assert all(after <= before + 1 for before, after in zip(found.headings, found.headings[1:], strict=False))
    assert found.wanted
    assert found.wanted <= found.known
    assert found.faults == []
    assert max(found.names.values(), default=1) == 1
    return found


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours, ``#rgb`` or ``#rrggbb`` (WCAG 2.2)."""
    light, dark = sorted(map(_luminance, (one, other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def _luminance(colour: str) -> float:
    digits = colour[1:] if len(colour) == 7 else "".join(2 * each for each in colour[1:])
    parts = [int(digits[place : place + 2], 16) / 255 for place in (0, 2, 4)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))
