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
ADDON = ROOT / "addon/dynamic_morph_targets"
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
# For code only: names that were, or that hide what a thing is.
NAMES = {
    r"told\s*\+?=[^=]|told, .*=|def \w*told\(": "messages, reported",
    r"heeded|unheard|_heed\b": "propagated, without_handlers, sync_settings",
    r"simulate\.STRETCH\b": "CHUNK_FRAMES",
    r"NativeMissing": "EngineNotFoundError",
    r"\.and_then\(": "concatenate",
    r"\bgo_on\b": "next_chunk",
    r"base\.guarded\(": "report_errors",
    r"obstacle": "disabled_reason",
    r"SinkError|SINKS?\b|\.sink\b": "WriteError, format",
    r"ClipError|CollectError": "KeysError, ReportPageError",
    r"RowProducts": "GramAccumulator",
    r"inversion_energy": "stabilizer",
    r"\bFloats\b|\bDoubles\b": "FloatW, DoubleW",
    r"in_parallel\(|for_chunks": "run_tasks, parallel_for",
    r"\bScheme\b": "Integrator",
    r"\bLaw::|enum class Law\b": "MaterialModel",
    r"\bheld_(?!\w)": "rest_gravity_",
    r"\btrial_(?!\w)|\bimage_(?!\w)": "d_, Hd_",
    r"\bdescend\(": "newton_direction",
    r"captured_variance": "explained_variance",
    r"modal_terms|namespace dynamorph::terms|\bterms::|for_each_term|add_eight_terms": "bone_pairs",
    r"set_threads\(int most": "limit",
    r"struct Under\b": "a name that says what it does",
    r"key_reach|baked\.reach|draw_reach": "key_displacement, largest_displacement, draw_extent",
    r"class (?:Volume|Flesh|Ways)\b": "Cage, InteriorGraph, ShortestPaths",
    r"struct (?:Cage|Flesh|Ways|Parting)\b": "CageSurface, InteriorGraph, ShortestPaths, MeshCut",
    r"modes\.frequencies\b": "omega",
}
# Modules of the extension that have other names now.
MODULES = {"sinks": "write/bake", "clips": "keys", "share": "cache_dir", "collect": "report_page", "volume": "cage"}
MODULES |= {"changes": "staleness"}


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


def test_old_names_are_gone():
    assert in_files(CODE, partial(wrong, NAMES)) == []
    assert [path.name for path in ADDON.rglob("*.py") if path.stem in MODULES] == []


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
        (
            partial(wrong, NAMES),
            "told = []\nheld_ = 1\nheld_parts\nterms::x\nSTRETCHED\nsimulate.STRETCH\n",
            {1, 2, 4, 6},
        ),
    ],
)
def test_words_are_found(check, text, lines):
    assert {each.split(": ")[0] for each in check("a.py", text)} == {f"a.py:{line}" for line in lines}
