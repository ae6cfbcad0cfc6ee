# SPDX-License-Identifier: GPL-3.0-or-later
"""One word for one idea, in American English: what sources, tests and pages must not say, and what they say instead."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = (".py", ".pyi", ".hpp", ".cpp")
PAGES = (".md", ".toml", ".yaml", ".yml", ".js", ".sh", ".cmake", ".txt", "Makefile", "de.json", "fr.json")
# Here words stand that are old on purpose, or quoted.
SKIPPED = {"CHANGELOG.md", "tests/engine/test_words.py"}

# Regular expressions, with what to write instead. Spelling: of words in lower case.
SPELLING = {
    r"(?<![a-z])(?:re)?cent(?:re[sd]?|ring)(?![a-z])": "center",
    r"neighbour": "neighbor",
    r"metres?(?![a-z])": "meter",
    r"colour": "color",
    r"(?<![a-z])grey": "gray",
    r"analys(?:e[ds]?|ing)(?![a-z])": "analyze",
    r"behaviour|favour|honour|labour": "or instead of our",
    r"licence": "license",
    r"(?:recogn|organ|normal|regular|minim|maxim|optim|vector|discret|initial|general|serial|visual|standard|local|quant|"
    r"linear|stabil|character|summar|synchron|parametr|vulcan)is(?:e[ds]?|ing|ations?)(?![a-z])": "z instead of s",
    r"(?:travel|model|label|signal|level|total)l(?:ed|ing)(?![a-z])": "one l",
    r"fibre": "fiber",
    r"(?<![a-z])(?:to|after|out|in|back|for|up|down)wards(?![a-z])": "no s at the end",
}
ENGLISH = {
    r"(?<!each )(?<!one )(?<!all )(?<!some )(?<!most )(?<!none )(?<!both )(?<=[\w,] )of which\b": "two sentences",
    r"\banew\b": "again",
    r"\bwhat (?:be)?comes? of\b": "outcome, result",
    r"\bcame to\b(?! rest)": "result",
    r"\bmend(?:s|ed|ing)?\b": "fix, repair",
    r"\bflesh\b": "soft tissue, or the body part",
    r"\bSettings [AB]\b": "Compare A / B",
    r"\bFree Bake\b": "Delete Bake",
    r"Weight \(kg\)": "Mass",
    r"Shape Key a Frame": "Shape Key Per Frame",
    r"\bSuggest Pose\b": "Find Uncovered Pose",
    r"\bFade-Out Radius\b": "Fade-Out Angle",
}


def files(suffixes: tuple[str, ...]) -> list[Path]:
    """What git tracks; without git, what is there."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout
    paths = [ROOT / name for name in listed.splitlines()] or [
        path for path in ROOT.rglob("*") if not any(part.startswith((".", "build")) for part in path.parts)
    ]
    wanted = [path for path in paths if path.name.endswith(suffixes) and path.is_file()]
    return [path for path in wanted if path.relative_to(ROOT).as_posix() not in SKIPPED]


def text_of(path: Path) -> str:
    """Of translations the English texts alone, each in its line."""
    text = path.read_text(encoding="utf-8")
    return re.sub(r'": ".*', '"', text) if path.suffix == ".json" else text


def wrong(words: dict[str, str], name: str, text: str) -> Iterator[str]:
    """file:line, the word, and what to write instead."""
    for word, instead in words.items():
        for match in re.finditer(word, text):
            yield f"{name}:{text.count(chr(10), 0, match.start()) + 1}: '{match[0].strip()}', write: {instead}"


@cache
def british(word: str) -> str:
    """What to write instead of a word; empty for one that is right."""
    return next((instead for old, instead in SPELLING.items() if re.search(old, word.lower())), "")


def misspelled(name: str, text: str) -> list[str]:
    """The same for spelling. Each distinct word is looked at once."""
    words = [word for word in set(re.findall(r"\w+", text)) - {"LICENCE"} if british(word)]  # a text block's name
    return [each for word in words for each in wrong({rf"\b{word}\b": british(word)}, name, text)]


def in_files(suffixes: tuple[str, ...], check: Callable[[str, str], Iterable[str]]) -> list[str]:
    return [each for path in files(suffixes) for each in check(path.relative_to(ROOT).as_posix(), text_of(path))]


def test_spelling_is_american():
    assert in_files(CODE + PAGES, misspelled) == []


def test_english_is_plain():
    assert in_files(CODE + PAGES, partial(wrong, ENGLISH)) == []


@pytest.mark.parametrize(
    ("check", "text", "lines"),
    [
        (misspelled, "the centre\nits CENTRES\nre-centred\nconcentrate, center\n", {1, 2, 3}),
        (
            misspelled,
            "Colour\nneighbours_of\nto_metres\nsymmetry, parameters\ngrey2\nlicence\nLICENCE",
            {1, 2, 3, 5, 6},
        ),
        (misspelled, "normalised\nraise, promise, precise, noise, exercise, rise\ntowards_it\nupward\n", {1, 3}),
        (
            partial(wrong, ENGLISH),
            "bones, of which two move\ntwo bones, both of which move; each of which\nanew",
            {1, 3},
        ),
    ],
)
def test_words_are_found(check, text, lines):
    assert {each.split(": ")[0] for each in check("a.py", text)} == {f"a.py:{line}" for line in lines}
