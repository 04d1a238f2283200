"""What a reader of a page sees without unfolding anything."""

import re
from html.parser import HTMLParser


class _Seen(HTMLParser):
    """Gathers the text outside closed details, apart for the first screen."""

    def __init__(self) -> None:
        super().__init__()
        self.everything: list[str] = []
        self.front: list[str] = []
        self._closed = 0
        self._hidden = 0
        self._in_summary = 0
        self._details: list[bool] = []
        self._sections: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag == "details":
            self._details.append("open" not in found)
            self._closed += self._details[-1]
        if tag in {"script", "style", "nav"}:
            self._hidden += 1
        if tag == "summary":
            self._in_summary += 1
        if tag == "section":
            self._sections.append(found.get("id") or "")

    def handle_endtag(self, tag: str) -> None:
        if tag == "details":
            self._closed -= self._details.pop()
        if tag in {"script", "style", "nav"}:
            self._hidden -= 1
        if tag == "summary":
            self._in_summary -= 1
        if tag == "section":
            self._sections.pop()
        # What stands in two elements is no one sentence.
        if tag in {"li", "p", "figcaption", "td", "th", "dd", "dt", "h1", "h2"}:
            self.handle_data("\n")

    def handle_data(self, data: str) -> None:
        if self._hidden or self._closed > (1 if self._in_summary else 0):
            return
        self.everything.append(data)
        if "front" in self._sections:
            self.front.append(data)


def words_seen(page: str) -> int:
    """Return how many words are there at first, outside of closed details."""
    return len(re.findall(r"\S*\w\S*", _seen(page)[0]))


def front_sentences(page: str) -> list[str]:
    """Return the sentences of the first screen: what ends with a full stop."""
    ends = re.findall(r"[^\n.]*(?:\.(?!\s|$)[^\n.]*)*\.(?=\s|$)", _seen(page)[1])
    return [each.strip() for each in ends]


def _seen(page: str) -> tuple[str, str]:
    seen = _Seen()
    seen.feed(page)
    seen.close()
    return "".join(seen.everything), "".join(seen.front)
