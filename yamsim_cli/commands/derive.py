from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError, count_noun
from yamsim_cli.flags.selection_file import SelectionFile
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line, progress_bar

if TYPE_CHECKING:
    from yamsim_cli.datasets.derive import DerivedDataset

_DEFAULT_PARTS = ("train=0.8", "test=0.2")
_PART = re.compile(r"^([A-Za-z0-9_][A-Za-z0-9_-]*)=([0-9.]+)$")

Out = Annotated[
    Path, typer.Option(metavar="DIR", help="Dataset to create. The same command continues an unfinished dataset.")
]


def merge(
    datasets: Annotated[list[Path], typer.Argument(help="Two or more datasets.", show_default=False)],
    out: Out,
    selection: Annotated[
        list[Path] | None,
        typer.Option(
            "--selection",
            metavar="FILE",
            help="A selection for each dataset, in the order of the datasets.",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Write the episodes of several datasets of one configuration as one dataset, and leave out equal episodes.

    provenance.json in it lists where each episode comes from. Trims stay in its selection.yaml; episodes are whole.

    Example: yamsim merge monday/ tuesday/ --out both/
    """
    if len(datasets) < 2:
        raise UsageError("yamsim merge needs two datasets or more; `yamsim filter` copies episodes of one")
    if selection and len(selection) != len(datasets):
        given = f"{count_noun(len(selection), 'selection')} for {len(datasets)} datasets"
        raise UsageError(f"--selection: {given}; give one for each dataset, in their order")
    session_opener.disable_gl()

    from yamsim_cli.datasets.derive import merge_datasets, open_source_dataset

    sources = [open_source_dataset(k, path, selection[k] if selection else None) for k, path in enumerate(datasets)]
    with progress_bar("copying", "episodes") as advance:
        done = merge_datasets(sources, out, advance)
    _print(done, json, [source.selection for source in sources])


def filter_dataset(
    dataset: Annotated[Path, typer.Argument(help="A dataset.", show_default=False)],
    out: Out,
    selection: SelectionFile = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="LIST", help="Numbers of the episodes, such as 0,3,5-9.  [default: all]")
    ] = None,
    json: Json = False,
) -> None:
    """Write some episodes of a dataset as a new dataset, numbered from 0.

    provenance.json in it lists where each episode comes from. Trims stay in its selection.yaml; episodes are whole.

    Example: yamsim filter dataset/ --selection dataset/selection.yaml --out kept/
    """
    if selection is None and episodes is None:
        raise UsageError("yamsim filter needs --selection FILE or --episodes LIST, which choose the episodes")
    session_opener.disable_gl()

    from yamsim_cli.datasets.derive import filter_dataset as run
    from yamsim_cli.datasets.derive import open_source_dataset

    source = open_source_dataset(0, dataset, selection, episodes)
    with progress_bar("copying", "episodes") as advance:
        done = run(source, out, advance)
    _print(done, json, [source.selection])


def split(
    dataset: Annotated[Path, typer.Argument(help="A dataset.", show_default=False)],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the parts. The same command continues an unfinished folder.")
    ],
    part: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=SHARE", help="A part; the shares add up to 1.  [default: train=0.8 test=0.2]"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random order of episodes.")] = 0,
    selection: SelectionFile = None,
    json: Json = False,
) -> None:
    """Write a dataset as parts that share no start: DIR/train and DIR/test.

    Episodes of the same seed and attempt, with the same start, or with the same values are never in different parts.

    Example: yamsim split dataset/ --out parts/ --part train=0.9 --part test=0.1
    """
    shares = _parse_shares(part or list(_DEFAULT_PARTS))
    session_opener.disable_gl()

    from yamsim_cli.datasets.derive import open_source_dataset, split_dataset

    source = open_source_dataset(0, dataset, selection)
    with progress_bar("copying", "episodes") as advance:
        done = split_dataset(source, out, shares, seed, advance)
    if json:
        parts = {name: made.report() for name, made in done.items()}
        print_json({"path": str(out), "parts": parts, "seed": seed, "selection": source.selection})
        return
    for made in done.values():
        print_line(_result_line(made))


def _parse_shares(parts: list[str]) -> dict[str, float]:
    shares: dict[str, float] = {}
    for text in parts:
        match = _PART.fullmatch(text)
        try:
            share = float(match[2]) if match else 0.0
        except ValueError:
            share = 0.0
        if not match or not 0 < share < 1 or match[1] in shares:
            raise UsageError(f"--part {text!r} is not valid: give NAME=SHARE once, with a share in 0..1, as train=0.8")
        shares[match[1]] = share
    if abs(sum(shares.values()) - 1) > 1e-6:
        raise UsageError(f"--part: the shares add up to {sum(shares.values()):g}; they must add up to 1")
    return shares


def _print(done: DerivedDataset, json: bool, selections: list[Any]) -> None:
    if json:
        print_json(done.report() | {"selections": selections})
    else:
        print_line(_result_line(done))


def _result_line(done: DerivedDataset) -> str:
    equal = f", {count_noun(done.duplicates, 'duplicate')} left out" if done.duplicates else ""
    return f"{count_noun(done.episodes, 'episode')}, {count_noun(done.frames, 'frame')} in {done.path}{equal}"
