import sys
import time

import pytest

from yamsim_cli.core.assets import SourceError
from yamsim_cli.core.assets.child import run_child


def test_what_a_program_writes_is_collected(tmp_path):
    code = "import sys; sys.stdout.write('o' * 200_000); sys.stderr.write('e'); sys.exit(3)"
    result = run_child([sys.executable, "-c", code], tmp_path, limit_s=20, idle_s=20)
    assert (result.returncode, len(result.stdout), result.stderr) == (3, 200_000, "e")


@pytest.mark.parametrize(
    ("limit_s", "idle_s", "reason"), [(0.3, 60, r"not done after 0\.3 s"), (60, 0.3, "nothing arrived")]
)
def test_a_program_that_hangs_is_ended_with_its_children(tmp_path, limit_s, idle_s, reason):
    loop = f"while sleep 0.05; do echo alive >> '{tmp_path}/beats'; done & wait"
    started = time.monotonic()
    with pytest.raises(SourceError, match=reason):
        run_child(["sh", "-c", loop], tmp_path, limit_s=limit_s, idle_s=idle_s, watch=lambda: 0)
    assert time.monotonic() - started < 5
    beats = (tmp_path / "beats").read_bytes()
    time.sleep(0.3)
    assert (tmp_path / "beats").read_bytes() == beats, "a grandchild lives on"


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
