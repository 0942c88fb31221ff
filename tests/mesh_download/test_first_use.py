"""A set that a command shows and the store lacks is fetched once, unless offline or with primitives."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.core.scene.assets.conftest import AssetFixture
from yamsim_cli.core.files.resources import MeshFolders
from yamsim_cli.mesh_download.fetch import FAILURE_VALID_S, default_sources, fetch
from yamsim_cli.session_opener import SessionOpener

Look = Callable[..., tuple[MeshFolders, list[str]]]


@pytest.fixture
def look(world: AssetFixture, local_pip: None, monkeypatch: pytest.MonkeyPatch) -> Look:
    """Look for the small set as a command does. Return the folders of meshes, and the notes to the user."""
    monkeypatch.setenv("MENAGERIE_ROOT", str(world.index))
    # pip starts within this time also on a busy machine.
    monkeypatch.setattr(sys.modules[default_sources.__module__], "MAX_IDLE_S", 120.0)

    def found(**environ: str) -> tuple[MeshFolders, list[str]]:
        told = list[str]()
        return SessionOpener(environ, told.append, str).with_mesh_folders(world.locations, ["tiny"]).meshes, told

    return found


def test_missing_meshes_are_fetched_once(look: Look, world: AssetFixture) -> None:
    meshes, told = look()
    assert meshes["tiny"] == world.store.folder_of_set(world.lock.sets["tiny"])
    assert told == ["The meshes of tiny are being fetched, which is done once."]
    assert look() == (meshes, [])


def test_offline_nothing_is_fetched(look: Look, world: AssetFixture) -> None:
    meshes, told = look(YAMSIM_OFFLINE="1")
    assert meshes == {"tiny": None}
    assert told == [
        "The meshes of tiny are not here, so primitives are shown: run `yamsim assets fetch`, or `yamsim doctor`."
    ]
    opener = SessionOpener({}, told.append, str)
    opener.stay_offline()
    assert opener.with_mesh_folders(world.locations, ["tiny"]).meshes == {"tiny": None}
    assert not world.store.root.exists()
    assert look(YAMSIM_OFFLINE="0")[0]["tiny"] is not None


def test_an_empty_folder_asks_for_primitives_and_stays_empty(look: Look, world: AssetFixture) -> None:
    world.store.root.mkdir()
    asked = {"YAMSIM_ASSETS": str(world.store.root)}
    assert look(**asked)[0] == {"tiny": None}
    assert list(world.store.root.iterdir()) == []
    assert look()[0]["tiny"] is not None, "the default cache may be empty"


@pytest.mark.slow
def test_a_failure_keeps_later_commands_from_waiting_for_an_hour(
    look: Look, world: AssetFixture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setenv("PIP_FIND_LINKS", str(tmp_path))
        meshes, told = look()
    assert meshes == {"tiny": None}
    assert told[1].startswith("The meshes of tiny are not here, so primitives are shown: could not fetch tiny (")
    meshes, told = look()
    assert meshes == {"tiny": None}
    assert "failed less than an hour ago" in told[1]
    past = time.time() - FAILURE_VALID_S - 1
    os.utime(world.store.fetch_failure_file, (past, past))
    assert look()[0]["tiny"] is not None
    assert not world.store.fetch_failure_file.exists()


@pytest.mark.slow
def test_a_fetch_that_works_ends_the_hour(look: Look, world: AssetFixture) -> None:
    world.store.root.mkdir()
    world.store.fetch_failure_file.touch()
    assert look()[0] == {"tiny": None}
    fetch(world.lock, ["tiny"], world.store, default_sources(world.lock))
    assert not world.store.fetch_failure_file.exists()


def test_a_store_that_cannot_be_written_shows_primitives(look: Look, world: AssetFixture) -> None:
    world.store.root.write_text("")
    meshes, told = look()
    assert meshes == {"tiny": None}
    assert "cannot write to the asset store" in told[1]


def test_an_index_that_says_nothing_is_given_up_after_the_first_set(
    look: Look, world: AssetFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny = world.raw["sets"]["tiny"]
    world.write_lock(world.raw | {"sets": {"tiny": tiny, "other": tiny | {"name": "other"}}})
    monkeypatch.setattr(sys.modules[default_sources.__module__], "MAX_IDLE_S", 1.0)
    monkeypatch.delenv("PIP_NO_INDEX")
    monkeypatch.delenv("PIP_FIND_LINKS")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        monkeypatch.setenv("PIP_INDEX_URL", f"http://127.0.0.1:{silent.getsockname()[1]}/simple")
        told = list[str]()
        began = time.monotonic()
        meshes = SessionOpener({}, told.append, str).with_mesh_folders(world.locations, ["tiny", "other"]).meshes
        took = time.monotonic() - began
    assert meshes == {"tiny": None, "other": None}
    assert "nothing arrived for 1 s" in told[1]
    assert "could not fetch tiny (" in told[1] and "other (" not in told[1]
    assert took < 10
