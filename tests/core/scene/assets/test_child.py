import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from yamsim_cli.core.scene.assets import SourceError
from yamsim_cli.core.scene.assets.child_process import run_child


def test_what_a_program_writes_is_collected(tmp_path):
    code = "import sys; sys.stdout.write('o' * 200_000); sys.stderr.write('e'); sys.exit(3)"
    result = run_child([sys.executable, "-c", code], tmp_path, limit_s=20, idle_s=20)
    assert (result.returncode, len(result.stdout), result.stderr) == (3, 200_000, "e")


@pytest.mark.parametrize(
    ("limit_s", "idle_s", "reason"), [(0.3, 60, r"not done after 0\.3 s"), (60, 0.3, "nothing arrived")]
)
def test_a_program_that_hangs_is_ended_with_its_children(tmp_path, limit_s, idle_s, reason):
    beats = tmp_path / "beats"
    beats.touch()  # the program may be ended before its first
    loop = f"while sleep 0.05; do echo alive >> '{beats}'; done & wait"
    started = time.monotonic()
    with pytest.raises(SourceError, match=reason):
        run_child(["sh", "-c", loop], tmp_path, limit_s=limit_s, idle_s=idle_s, watch=lambda: 0)
    assert time.monotonic() - started < 30
    before = beats.read_bytes()
    time.sleep(0.3)
    assert beats.read_bytes() == before, "a grandchild lives on"


def test_a_slow_program_that_moves_is_left_alone(tmp_path):
    ticks = iter(range(1000))
    result = run_child(["sleep", "0.8"], tmp_path, limit_s=20, idle_s=0.3, watch=lambda: next(ticks))
    assert result.returncode == 0


def test_an_interrupt_ends_the_program(tmp_path):
    def interrupt() -> int:
        raise KeyboardInterrupt

    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_child(["sleep", "60"], tmp_path, limit_s=60, idle_s=60, watch=interrupt)
    assert time.monotonic() - started < 5


def test_a_program_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(SourceError, match="cannot run no-such-program"):
        run_child(["no-such-program"], tmp_path, limit_s=1, idle_s=1)


def test_a_child_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    script = f"""
from pathlib import Path
from yamsim_cli.core.scene.assets.child_process import run_child
run_child(["sh", "-c", "echo $$ > {tmp_path}/pid; exec sleep 60"], Path({str(tmp_path)!r}), limit_s=60, idle_s=60)
"""
    parent = subprocess.Popen(
        [sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    )
    try:
        pid = wait_for(lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text().strip())
    finally:
        parent.kill()
        parent.wait()
    state = Path(f"/proc/{pid}/stat")
    wait_for(lambda: not state.is_file() or state.read_text().split()[2] == "Z")


def wait_for(found: Callable[[], str | bool]) -> str | bool:
    """Return what is found within 10 s."""
    end = time.monotonic() + 10
    while not (value := found()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return value
