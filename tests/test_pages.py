"""What README and `docs/` name is there: files, headings, settings, commands with their options, routes, modules."""

import ast
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import typer
from markdown_it import MarkdownIt

from skyfolio.api.cli.lazy import load
from skyfolio.api.cli.main import Commands, cli
from skyfolio.api.common.settings import PREFIX, Settings
from skyfolio.api.http.app import create_app

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted(ROOT.glob("docs/*.md"))]
PRODUCT = ("planner", "mavlink_bridge", "sim", "api", "tests", "docs", "scripts")
SESSION_ONLY = {"SKYFOLIO_API"}
"""Variables of the shell session in `docs/api.md` itself."""
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def code_spans(page: Path) -> list[str]:
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text())
    return [part.content for token in tokens for part in token.children or () if part.type == "code_inline"]


def blocks(page: Path, *languages: str) -> list[str]:
    tokens = MarkdownIt("commonmark").parse(page.read_text())
    return [token.content for token in tokens if token.type in {"fence", "code_block"} and token.info in languages]


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@each_page
def test_links_lead_to_files_and_headings_that_are_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        name, _, heading = target.partition("#")
        file = (page.parent / name) if name else page
        assert file.exists(), target
        assert not heading or heading in anchors(file), target


@each_page
def test_paths_in_code_spans_are_there(page: Path) -> None:
    for span in code_spans(page):
        if re.fullmatch(r"[\w./-]+", span) and span.split("/")[0] in PRODUCT and "/" in span:
            assert (ROOT / span).exists(), span


@each_page
def test_settings_are_those_of_the_service(page: Path) -> None:
    known = {PREFIX + name.upper() for name in Settings.model_fields} | SESSION_ONLY
    assert set(re.findall(rf"\b{PREFIX}[A-Z_]*[A-Z]\b", page.read_text())) <= known


def command_named(words: list[str]) -> tuple[Any, list[str]]:
    """Return the command that the words call, and the words left for it."""
    command = typer.main.get_command(cli)
    while words and hasattr(command, "commands"):
        later = Commands.commands_by_name.get(words[0]) if isinstance(command, Commands) else None
        found = load(words[0], later) if later else command.commands.get(words[0])
        if found is None:
            break
        command, words = found, words[1:]
    return command, words


@each_page
def test_commands_and_their_options_exist(page: Path) -> None:
    lines = [line for block in blocks(page, "sh", "text", "") for line in block.splitlines()] + code_spans(page)
    called = [match for line in lines for match in re.findall(r"(?:^|[/ ])skyfolio ([a-z][^|#&`]*)", line)]
    for words in (call.split() for call in called if "=" not in call.split()[0]):
        command, rest = command_named(words)
        assert rest != words, f"skyfolio {' '.join(words)}: there is no such command"
        options = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        wanted = {word.strip("[]").partition("=")[0] for word in rest if word.strip("[]").startswith("--")}
        assert wanted - {"--help"} <= options, f"skyfolio {' '.join(words)}"


@each_page
def test_make_targets_exist(page: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    spans = [*code_spans(page), *(line for block in blocks(page, "sh") for line in block.splitlines())]
    assert {span.split()[1] for span in spans if re.match(r"make [a-z]", span)} <= targets


@pytest.fixture(scope="module")
def routes() -> set[tuple[str, str]]:
    """Method and path of every route, without `/v1/` and with `{}` for each parameter."""
    description = create_app(Settings(warm_up=False), ui=False).openapi()
    return {
        (method.upper(), re.sub(r"\{[^}]*\}", "{}", path.removeprefix("/v1/").lstrip("/")))
        for path, methods in description["paths"].items()
        for method in methods
    }


@each_page
def test_routes_exist(page: Path, routes: set[tuple[str, str]]) -> None:
    for span in code_spans(page):
        for method, path in re.findall(r"^(GET|POST|PUT|PATCH|DELETE) (\S+)", span):
            plain = re.sub(r"\{[^}]*\}", "{}", path.split("?")[0].removeprefix("/v1/").lstrip("/"))
            first, *others = plain.split("|:")
            base = first.rpartition(":")[0]
            for wanted in (first, *(f"{base}:{other}" for other in others)):
                assert (method, wanted) in routes, span


@each_page
def test_python_blocks_import_what_there_is(page: Path) -> None:
    for block in blocks(page, "python"):
        for node in ast.walk(compile(block, str(page), "exec", ast.PyCF_ONLY_AST | ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)):
            if isinstance(node, ast.ImportFrom):
                module = import_module(node.module or "")
                assert all(hasattr(module, alias.name) for alias in node.names), ast.unparse(node)
