"""`scripts/prose.py` finds the words that are not used, and nothing else."""

from pathlib import Path

import pytest

from scripts.prose import IN_FUNCTION, Configuration, Rule, Text, configuration, findings, in_docstrings, in_page

CONFIG = configuration()
NOT_YET: set[str] = set()
"""What was not in shape when the check was made. Names are only ever taken out of this set."""


def broken(rule: Rule, words: str) -> list[str]:
    return [found for _, found in rule.found_in(Text(Path("x.md"), 1, words, rule.only))]


@pytest.mark.parametrize(
    ("rule", "words"),
    [(rule, words) for rule in CONFIG.rules for words in rule.flags],
    ids=lambda value: str(value)[:40],
)
def test_a_rule_finds_the_sentences_that_it_is_for(rule: Rule, words: str) -> None:
    assert broken(rule, words)


@pytest.mark.parametrize(
    ("rule", "words"),
    [(rule, words) for rule in CONFIG.rules for words in rule.passes],
    ids=lambda value: str(value)[:40],
)
def test_a_rule_leaves_good_sentences_alone(rule: Rule, words: str) -> None:
    assert broken(rule, words) == []


def test_every_rule_shows_what_it_finds_and_what_it_leaves_alone() -> None:
    assert all(rule.flags and rule.passes and rule.instead for rule in CONFIG.rules)


def test_the_list_of_files_that_are_not_in_shape_does_not_grow() -> None:
    assert set(CONFIG.not_yet) <= NOT_YET


def test_code_in_a_page_is_not_prose(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("A `nobody` is fine.\n\n```sh\necho nobody\n```\n\n| a | nobody |\n|---|---|\n| b | nobody\n")
    assert [(text.line, text.words) for text in in_page(page) if "nobody" in text.words] == [
        (1, "A `nobody` is fine."),
        (7, "nobody"),
        (9, "nobody"),
    ]


def test_a_finding_names_file_line_words_and_what_to_write(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("A `nobody`.\n\nFine so far,\nbut then nobody\nis heard.\n")
    (tmp_path / "code.py").write_text('"""Module."""\n\n\ndef flies() -> bool:\n    """Whether it\n    flies."""\n')
    config = Configuration(CONFIG.rules, pages=("*.md",), docstrings=("*.py",), interface=(), not_yet=())
    first, second = findings(config, tmp_path)
    assert first.startswith('code.py:5: "Whether": ')
    assert second.startswith('page.md:4: "nobody": ')


def test_a_property_is_not_held_to_the_form_of_a_function(tmp_path: Path) -> None:
    source = tmp_path / "code.py"
    source.write_text(
        "class A:\n"
        '    """Class."""\n'
        "    @property\n"
        "    def a(self) -> bool:\n"
        '        """Whether it is."""\n'
        "    def b(self) -> bool:\n"
        '        """Return whether it is."""\n'
        "    c = 1\n"
        '    """Attribute."""\n'
    )
    assert [(text.line, text.kind) for text in in_docstrings(source)] == [(2, ""), (9, ""), (5, ""), (7, IN_FUNCTION)]
