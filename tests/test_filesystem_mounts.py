from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path, PurePosixPath

import pytest

from yamsim_cli.filesystem_mounts import Mount, mount_at, network_mount, parse_mounts, read_mounts

TABLE = """\
22 27 0:21 / /proc rw,relatime - proc proc rw
27 1 254:0 / / rw,relatime - ext4 /dev/vda rw,discard
40 27 0:50 / /home rw,relatime shared:1 master:2 - nfs4 server:/home rw,vers=4.2,local_lock=none
41 27 0:51 / /mnt/old rw - nfs nas:/old rw,nolock
42 27 0:52 / /mnt/with\\040blank rw - fuse.sshfs me@host:/a\\040b rw,user_id=0
43 40 254:1 /scratch /home/me/scratch rw - xfs /dev/vdb rw
44 27 0:53 / /mnt rw - tmpfs tmpfs rw
45 44 0:54 / /mnt/new rw - cifs //nas/share rw
46 27 0:55 / /twice rw - ext4 /dev/vdc rw
47 46 0:56 / /twice rw - fuse.rclone remote: rw
48 27 0:57 / /net rw - autofs /etc/auto.net rw,indirect
49 27 0:58 / /overlay rw - fuse.fuse-overlayfs fuse-overlayfs rw
"""
MOUNTS = parse_mounts(TABLE)


def kind(path: str) -> str | None:
    mount = mount_at(PurePosixPath(path), MOUNTS)
    return mount.kind if mount else None


@pytest.mark.parametrize(
    ("path", "wanted"),
    [
        ("/", "ext4"),
        ("/homework", "ext4"),
        ("/home", "nfs4"),
        ("/home/me/data", "nfs4"),
        ("/home/me/scratch/data", "xfs"),
        ("/mnt/new/x", "cifs"),
        ("/mnt/old/x", "tmpfs"),  # hidden by the later mount on /mnt
        ("/twice/x", "fuse.rclone"),
    ],
)
def test_the_mount_of_a_path(path: str, wanted: str) -> None:
    assert kind(path) == wanted


def test_names_with_blanks_are_read() -> None:
    mount = next(mount for mount in MOUNTS if mount.mount_id == 42)
    assert (str(mount.point), mount.source) == ("/mnt/with blank", "me@host:/a b")


def test_lines_that_make_no_sense_are_passed_over() -> None:
    assert parse_mounts("\nnonsense\n1 2 3 - x\n") == []
    assert mount_at(PurePosixPath("/x"), []) is None


class FakeLinks:
    """Links on a disk that record the requests."""

    def __init__(self, links: dict[str, str]) -> None:
        self.links = links
        self.asked: list[str] = []

    def __call__(self, path: str) -> str:
        self.asked.append(path)
        if path not in self.links:
            raise OSError
        return self.links[path]


@pytest.mark.parametrize(
    ("path", "wanted"),
    [
        ("/data/x", None),
        ("/home/me/data", "nfs4"),
        ("/home/me/scratch/x", None),
        ("/overlay/x", None),
        ("/net/server/x", "autofs"),
        ("/data/to_home/x", "nfs4"),
        ("/data/relative/x", "cifs"),
        ("/data/to_home/../x", "nfs4"),  # `..` of the link's target
        ("/data/chain", "nfs4"),
        ("/data/loop/x", None),
        ("/data/a/../to_home", "nfs4"),
    ],
)
def test_where_a_path_leads(path: str, wanted: str | None) -> None:
    links = FakeLinks(
        {
            "/data/to_home": "/home/me/out",
            "/data/relative": "../mnt/new",
            "/data/chain": "second",
            "/data/second": "/data/to_home",
            "/data/loop": "loop",
        }
    )
    mount = network_mount(Path(path), MOUNTS, links)
    assert (mount.kind if mount else None) == wanted


def test_nothing_on_a_network_mount_is_asked() -> None:
    links = FakeLinks({"/data/link": "/home/me"})
    for path in ("/home/me/data", "/data/link/deeper", "/net/server", "/mnt/new/x/y"):
        network_mount(Path(path), MOUNTS, links)
    network = [PurePosixPath(mount.point) for mount in MOUNTS if mount.is_network and mount.mount_id != 41]
    assert [path for path in links.asked if any(PurePosixPath(path).is_relative_to(point) for point in network)] == []


def test_a_relative_path_is_below_the_current_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mounts = [
        Mount(1, 0, PurePosixPath("/"), "ext4", "/dev/vda", frozenset()),
        Mount(2, 1, PurePosixPath(tmp_path) / "far", "nfs", "nas:/", frozenset()),
    ]
    assert network_mount(Path("far/dataset"), mounts) == mounts[1]
    assert network_mount(Path("near"), mounts) is None


@pytest.mark.parametrize(
    ("number", "reach"), [(27, True), (40, True), (41, False), (42, False), (45, True), (47, False), (48, False)]
)
def test_which_locks_reach_other_machines(number: int, reach: bool) -> None:
    assert next(mount for mount in MOUNTS if mount.mount_id == number).locks_reach_others is reach


def test_this_machine_has_a_root() -> None:
    mount = mount_at(PurePosixPath("/"), read_mounts())
    assert mount is not None
    assert mount.point == PurePosixPath("/")


def test_a_mount_that_hangs_is_recognised_without_hanging(tmp_path: Path) -> None:
    """A stopped FUSE server: any access to its mount would wait forever."""
    if shutil.which("bindfs") is None:
        pytest.skip("bindfs is not installed")
    source, point = tmp_path / "source", tmp_path / "point"
    source.mkdir()
    point.mkdir()
    server = subprocess.Popen(["bindfs", "-f", str(source), str(point)], stderr=subprocess.PIPE, text=True)
    try:
        while not (seen := network_mount(point / "x", read_mounts())):
            if server.poll() is not None:
                assert server.stderr
                pytest.skip(f"FUSE is not allowed here: {server.stderr.read().strip()}")
        server.send_signal(signal.SIGSTOP)
        code = (
            "from pathlib import Path\n"
            "from yamsim_cli.filesystem_mounts import network_mount, read_mounts\n"
            f"print(network_mount(Path({str(point / 'deep' / 'er')!r}), read_mounts()).kind)"
        )
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True, env=environment
        )
        assert done.stdout.strip() == seen.kind == "fuse"
    finally:
        server.send_signal(signal.SIGCONT)
        subprocess.run(["umount", "-l", str(point)], check=False, capture_output=True)
        server.kill()
        server.wait()
