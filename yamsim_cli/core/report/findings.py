"""The dataset's faults on the page: a verdict at the top, and a table by code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .markup import Markup, tag

# Examples that are shown for each code; --json has them all.
_EXAMPLES = 5


def verdict(summary: Mapping[str, Any]) -> Markup:
    """One line on whether the dataset can be trained on."""
    errors, warnings = summary["errors"], summary["warnings"]
    if not summary["episodes"] and not errors:
        text, kind = "There is no episode in it yet.", "warning"
    elif errors:
        text, kind = (
            f"{_count(errors, 'error')} and {_count(warnings, 'warning')}: not to be trained on as it is.",
            "error",
        )
    elif warnings:
        text, kind = f"Whole, with {_count(warnings, 'warning')} to look at.", "warning"
    else:
        text, kind = "Whole: every file was opened and is as it should be.", "fine"
    return tag("p", tag("span", text), class_=f"verdict {kind}")


def problems_section(summary: Mapping[str, Any]) -> Markup | None:
    """A table of the codes that were found, with counts, examples and advice; None if there are none."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for problem in summary["problems"]:
        groups.setdefault(problem["code"], []).append(problem)
    if not groups:
        return None
    rows = [_row(code, problems) for code, problems in sorted(groups.items(), key=lambda item: item[1][0]["severity"])]
    headings = (("problem", None), ("found", "number"), ("what and where", None), ("what to do", None))
    head = tag("tr", [tag("th", text, scope="col", class_=kind) for text, kind in headings])
    table = tag("table", tag("thead", head), tag("tbody", rows))
    return tag("section", tag("h2", "Problems"), tag("div", table, class_="scroll"))


def _row(code: str, problems: Sequence[Mapping[str, Any]]) -> Markup:
    examples = [tag("li", _example(problem)) for problem in problems[:_EXAMPLES]]
    if len(problems) > _EXAMPLES:
        examples.append(tag("li", f"and {len(problems) - _EXAMPLES:,} more"))
    first = problems[0]
    return tag(
        "tr",
        tag("td", tag("code", code, class_=first["severity"]), class_="code"),
        tag("td", f"{len(problems):,}", class_="number"),
        tag("td", first["title"], tag("ul", examples)),
        tag("td", _advice(first["advice"]), class_="advice"),
    )


def _advice(text: str) -> list[str]:
    """Advice, with commands between backquotes set as code."""
    return [tag("code", part) if k % 2 else part for k, part in enumerate(text.split("`"))]


def _example(problem: Mapping[str, Any]) -> list[Any]:
    place = "/".join(part for part in (problem["episode"], problem["file"]) if part)
    valid = f"; valid: {problem['valid']}" if problem["valid"] else ""
    more = f" (in {problem['count']} frames)" if problem["count"] > 1 else ""
    said = f"{problem['value']}{valid}{more}"
    return [tag("code", place) if place else None, ": " if place and said else None, said]


def _count(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"
