"""The pages hold what they promise: every sentence has an entry, every key its words, every option is listed."""

import re
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from quadrig.io.commands.main import COMMANDS

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def makers() -> Iterator[Callable[[str], ModuleType]]:
    """makers("commands"): a maker of pages; they are modules of one folder, as mkdocs loads them."""
    sys.path.insert(0, str(ROOT / "pages"))
    yield import_module
    sys.path.remove(str(ROOT / "pages"))


def test_every_sentence_that_can_be_said_has_an_entry(makers) -> None:
    troubleshooting = makers("troubleshooting")

    page = troubleshooting.PAGE.read_text()
    claims = troubleshooting.claims(page)
    said = troubleshooting.all_sentences()
    assert len(said) > 300
    new = [sentence for sentence in said if troubleshooting.taker(sentence, claims) is None]
    assert new == [], "name their files in a `says` comment of docs/troubleshooting.md, and explain them there"


def test_no_entry_is_for_what_nobody_says(makers) -> None:
    troubleshooting = makers("troubleshooting")

    claims = troubleshooting.claims(troubleshooting.PAGE.read_text())
    said = troubleshooting.all_sentences()
    idle = [claim for claim in claims if not any(claim.takes(sentence) for sentence in said)]
    idle += [
        (claim.module, word)
        for claim in claims
        for word in claim.words
        if not any(s.module == claim.module and word in s.text for s in said)
    ]
    assert idle == []


def test_a_new_sentence_is_noticed(makers) -> None:
    troubleshooting = makers("troubleshooting")
    claims = troubleshooting.claims(troubleshooting.PAGE.read_text())
    assert (
        troubleshooting.taker(
            makers("sentences").Sentence("something new and strange happened", "io/new_module.py"), claims
        )
        is None
    )


def test_every_key_of_rig_toml_has_its_words_and_no_words_are_left_over(makers) -> None:
    rig_toml = makers("rig_toml")

    keys = {name: {key.name for key in table.fields} for name, table in rig_toml.tables().items()}
    assert {name: set(words) for name, words in rig_toml.WORDS.items()} == keys


def test_every_command_is_listed_with_its_examples(makers) -> None:
    commands = makers("commands")

    page = commands.page()
    assert re.findall(r"^## rig (\w+)", page, re.M) == list(COMMANDS)
    assert all(commands.examples(name) for name in COMMANDS)


def test_every_page_is_reached() -> None:
    reached = set(re.findall(r"[\w-]+\.md", (ROOT / "mkdocs.yml").read_text()))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} == reached


def test_what_is_said_of_the_code_is_there() -> None:
    """`name` in `folder/file.py`, as the mathematics says where each equation is."""
    for page in ("mathematics.md", "python.md", "figures.md"):
        text = (ROOT / "docs" / page).read_text()
        for name, file in re.findall(r"`([\w.]+)` in `([\w/]+\.py)`", text):
            assert name.split(".")[-1] in (ROOT / file).read_text(), (page, name, file)
        for file in re.findall(r"`((?:single|rig|io|benchmarks|examples|tests)/[\w/]+\.py)", text):
            assert (ROOT / file).is_file(), (page, file)
