"""Checks the words of pages, docstrings and user-interface texts against `scripts/prose.toml`; part of `make lint`.

Markdown is parsed by markdown-it, Python by `ast`; code, code spans and identifiers are left out. Each finding is one
line, `file:line: "words found": what to write instead`, and the exit status is 1 if there is any.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[1]
CODE_SPAN = re.compile(r"`+[^`]*`+")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
IN_FUNCTION = "function"
"""Kind of text: the docstring of a function that is not a property. Rules may be limited to it by `only`."""


@dataclass(frozen=True)
class Text:
    """A piece of prose, where it begins, and whether it documents a function."""

    path: Path
    line: int
    words: str
    kind: str = ""


@dataclass(frozen=True)
class Rule:
    """Words that are not used, and what to write instead."""

    pattern: re.Pattern[str]
    instead: str
    flags: tuple[str, ...]
    """Sentences that the rule must find."""
    passes: tuple[str, ...]
    """Sentences that it must leave alone."""
    only: str = ""

    def found_in(self, text: Text) -> Iterator[tuple[int, str]]:
        """Yield line and words of each place that breaks the rule."""
        if self.only and self.only != text.kind:
            return
        words = CODE_SPAN.sub("`", text.words)
        for match in self.pattern.finditer(words):
            yield text.line + words.count("\n", 0, match.start()), " ".join(match.group().split())


@dataclass(frozen=True)
class Configuration:
    """What is checked, by which rules."""

    rules: tuple[Rule, ...]
    pages: tuple[str, ...]
    docstrings: tuple[str, ...]
    interface: tuple[str, ...]
    not_yet: tuple[str, ...]


def configuration(path: Path = ROOT / "scripts" / "prose.toml") -> Configuration:
    """Read the rules. Raises KeyError, re.error and tomllib.TOMLDecodeError for a broken file."""
    table = tomllib.loads(path.read_text())
    rules = (
        Rule(
            pattern=re.compile(rule["words"].replace(" ", r"\s+"), re.IGNORECASE),
            instead=rule["instead"],
            flags=tuple(rule["flags"]),
            passes=tuple(rule["passes"]),
            only=rule.get("only", ""),
        )
        for rule in table["rule"]
    )
    where = {name: tuple(table[name]) for name in ("pages", "docstrings", "interface", "not_yet")}
    return Configuration(rules=tuple(rules), **where)


def in_page(path: Path) -> Iterator[Text]:
    """Yield the paragraphs, headings and table cells of a Markdown page; fenced code is left out."""
    for token in MarkdownIt("commonmark").enable("table").parse(path.read_text()):
        if token.type == "inline" and token.map:
            yield Text(path, token.map[0] + 1, token.content)


def in_docstrings(path: Path) -> Iterator[Text]:
    """Yield the docstrings of a Python file, those of attributes included."""
    for node in ast.walk(ast.parse(path.read_text())):
        for child in node.body if isinstance(node, DOCUMENTED) else ():
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                words = child.value.value
                if isinstance(words, str):
                    yield Text(path, child.lineno, words, _kind(node, child))


def _kind(owner: ast.AST, docstring: ast.Expr) -> str:
    if not isinstance(owner, ast.FunctionDef | ast.AsyncFunctionDef) or owner.body[0] is not docstring:
        return ""
    return "" if any("property" in ast.unparse(each) for each in owner.decorator_list) else IN_FUNCTION


def in_interface(path: Path) -> Iterator[Text]:
    """Yield what a file may show to a user: strings of several words in Python, every line of a script."""
    if path.suffix == ".js":
        yield from (Text(path, number, line) for number, line in enumerate(path.read_text().splitlines(), start=1))
        return
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield Text(path, node.lineno, node.value)


def texts(config: Configuration, root: Path = ROOT) -> Iterator[Text]:
    """Yield everything that is checked below `root`."""
    for pattern in config.pages:
        for path in sorted(root.glob(pattern)):
            yield from in_page(path)
    for path in _sources(config.docstrings, config, root):
        yield from in_docstrings(path)
    for path in _sources(config.interface, config, root):
        yield from in_interface(path)


def _sources(patterns: tuple[str, ...], config: Configuration, root: Path) -> Iterator[Path]:
    skipped = {path for pattern in config.not_yet for path in root.glob(pattern)}
    for pattern in patterns:
        yield from (path for path in sorted(root.glob(pattern)) if path not in skipped)


def findings(config: Configuration, root: Path = ROOT) -> list[str]:
    """Return one line for each place that breaks a rule, in order."""
    found = {
        (str(text.path.relative_to(root)), line, words, rule.instead)
        for text in texts(config, root)
        for rule in config.rules
        for line, words in rule.found_in(text)
    }
    return [f'{path}:{line}: "{words}": {instead}' for path, line, words, instead in sorted(found)]


def main() -> int:
    """Print the findings and return the exit status."""
    lines = findings(configuration())
    sys.stdout.writelines(f"{line}\n" for line in lines)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
