from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..core.markup import Markup, html_page, html_section, html_table, html_tag, percent

# Which policies of a pair succeeded on a trial, in table order.
_OUTCOMES = ("both", "only_first", "only_second", "neither")


def leaderboard_page(reports: Sequence[Mapping[str, Any]], pairs: Sequence[Mapping[str, Any]], made: str) -> str:
    """Return an HTML page that compares the success rates of policies.

    Args:
        reports: results of `evaluation_report`, the evaluated policy first.
        pairs: results of `compare_reports` for the evaluated policy and each other one.
        made: text at the foot of the page.
    """
    first = reports[0]
    ranked = sorted(reports, key=lambda report: -report["stats"]["success_rate"])
    title = f"{first['task']} on {first['rig']}"
    answers = ("answer time, median", "answer time, 95 %")
    headings = ("policy", "success", "95 % interval", *answers, "actions", "stale actions", "time without an action")
    body = [
        html_tag("p", f"{len(first['trials'])} trials of seed {first['seed']}, grasp {first['grasp']}"),
        html_table(headings, map(_policy_row, ranked)),
        _pair_table(first, pairs),
        _instance_table(ranked),
    ]
    return html_page(f"{title}: leaderboard", "Leaderboard", title, body, made)


def _policy_row(report: Mapping[str, Any]) -> list[str]:
    stats = report["stats"]
    chunks = stats["chunks"]
    return [
        report["policy"],
        f"{stats['n_success']} of {stats['n']} ({percent(stats['success_rate'])})",
        _interval(stats["wilson95"]),
        _ms(stats["policy_s"], "median"),
        _ms(stats["policy_s"], "p95"),
        f"{chunks['actions']:,}",
        f"{chunks['stale']:,}",
        f"{chunks['waited_s']:.2f} s",
    ]


def _pair_table(first: Mapping[str, Any], pairs: Sequence[Mapping[str, Any]]) -> Markup | None:
    if not pairs:
        return None
    cells = [
        [pair["policy"], *(str(pair[key]) for key in _OUTCOMES), _difference(pair), f"{pair['p_value']:.3g}"]
        for pair in pairs
    ]
    outcomes = ("both", f"only {first['policy']}", "only the other policy", "neither")
    headings = ("other policy", *outcomes, "difference (95 % interval)", "p (McNemar, exact)")
    return html_section("Comparison by trial", html_table(headings, cells))


def _instance_table(reports: Sequence[Mapping[str, Any]]) -> Markup:
    cells = [
        [
            one["instance"],
            report["policy"],
            f"{one['n_success']} of {one['n']}",
            _interval(one["wilson95"]),
            _ms(one["policy_s"], "median"),
        ]
        for report in reports
        for one in report["stats"]["by_instance"]
    ]
    cells.sort(key=lambda row: row[0])
    return html_section(
        "By instance", html_table(("instance", "policy", "success", "95 % interval", "answer time, median"), cells)
    )


def _difference(pair: Mapping[str, Any]) -> str:
    low, high = pair["difference95"]
    return f"{pair['difference']:+.1%} ({low:+.1%} to {high:+.1%})"


def _interval(bounds: Sequence[float]) -> str:
    return f"{percent(bounds[0])} to {percent(bounds[1])}"


def _ms(spread: Mapping[str, float] | None, which: str) -> str:
    return f"{spread[which] * 1000:.1f} ms" if spread else "none"
