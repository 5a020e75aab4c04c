"""Sentences of a Markdown page and their lengths in words."""

import re
from dataclasses import dataclass

__all__ = ["Sentence", "sentences", "words_of"]

FENCE = re.compile(r"^ *```.*?^ *```[^\n]*$", re.M | re.S)
COMMENT = re.compile(r"<!--.*?-->", re.S)
IMAGE = re.compile(r"!\[[^\]]*\]\([^)]*\)")
LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
CODE = re.compile(r"`[^`]*`")

LEFT_OUT = re.compile(r"^ *(\||#|>|\[[^\]]+\]:)")
"""Rows of tables, headings, quoted lines (output, formulas) and targets of links."""

ITEM = re.compile(r"^ *([-*+]|\d+[.)]) +")

FORMULA = re.compile(r"^ {4,}\S")
"""Only after an empty line outside of a list: otherwise it goes on with an item."""

LEAD = re.compile(r"^\*\*[^*]+[.:]\*\* +")
"""A heading in the line of its paragraph."""

END = re.compile(r"(?<=[.!?])[\"”»)*_]* +(?=[\"“«(*_\[]*[A-Z0-9`δ±≈])")
ABBREVIATION = re.compile(r"\b(e\.g|i\.e|etc|vs|al|approx|Fig|Sec|No)\.$")


@dataclass(frozen=True)
class Sentence:
    """A sentence, or an item of a list that has no full stop."""

    text: str

    @property
    def length(self) -> int:
        """Words: what stands between spaces and has a letter or a digit; code counts as it is written."""
        return len(words_of(self.text))


def words_of(text: str) -> list[str]:
    """What stands between spaces and has a letter or a digit."""
    return [word for word in text.split() if re.search(r"\w", word)]


def paragraphs(page: str) -> list[str]:
    """Prose of a page: paragraphs and items of lists, each in one line."""
    page = COMMENT.sub("", FENCE.sub("\n\n", page))
    page = LINK.sub(r"\1", IMAGE.sub("", page))
    found: list[list[str]] = [[]]
    is_in_list = False
    for line in page.splitlines():
        if not line.strip() or LEFT_OUT.match(line):
            found.append([])
            continue
        is_item = ITEM.match(line) is not None
        if not found[-1] and not is_item:
            is_in_list = is_in_list and line.startswith(" ")
        if not is_in_list and not is_item and not found[-1] and FORMULA.match(line):
            continue
        if is_item:
            found.append([])
            is_in_list = True
        found[-1].append(ITEM.sub("", line).strip())
    return [LEAD.sub("", " ".join(lines)) for lines in found if lines]


def sentences(page: str) -> list[Sentence]:
    """Sentences of the prose of a Markdown page, in its order."""
    return [Sentence(text) for paragraph in paragraphs(page) for text in split(paragraph)]


def split(paragraph: str) -> list[str]:
    """Sentences of a paragraph; full stops inside code and after abbreviations end none."""
    hidden = CODE.sub(lambda match: f"`{'x' * (len(match[0]) - 2)}`", paragraph)
    parts, start = [], 0
    for match in END.finditer(hidden):
        if not ABBREVIATION.search(hidden[start : match.start()]):
            parts.append(paragraph[start : match.end()].strip())
            start = match.end()
    parts.append(paragraph[start:].strip())
    return [part for part in parts if words_of(part)]
