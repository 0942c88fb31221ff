"""How a test runs the pages' command lines: smaller sizes, servers, and lines that cannot run."""

from __future__ import annotations

import re
import shlex

# Pattern -> replacement in a test; pages use larger sizes than a test needs.
SMALLER = {
    # Later lines name the fourth episode of this dataset.
    r"--n 500 --workers 4$": "--n 4 --workers 2",
    r"--n \d{2,}": "--n 1",
    r"--task handover (.*)--n \d": r"--task handover \1--n 1",
    r"--sample \d+": "--sample 2",
    r"--size 848x480": "--size 160x120",
    # Places that no test may write to.
    r"/data/episodes": "episodes",
}

# Start of a line -> flags to add for speed.
CHEAPER = {
    "yamsim record": "--workers 1 --quality fast --size 160x120",
    "yamsim draw": "--workers 1 --quality fast --size 96x72",
    "yamsim teleop": "--quality fast --size 160x120",
    "yamsim eval": "--n 1 --workers 1 --quality fast --size 96x72 --time-limit 1",
    "yamsim render-views": "--quality fast --size 160x120",
    "yamsim serve-robot": "--seconds 1 --quality fast --size 160x120",
    "yamsim excite": "--seconds 20",
    # The test's stand-ins for a user's files are mugs with 24 sides, whose certificates fail.
    "yamsim assets import my_mug.glb": "--no-certify",
    "yamsim assets import scan.obj": "--no-certify",
}

# Start of a line -> flags without which it serves until a signal. It prints its URL first, and its exit code is 0 after
# SIGINT. It runs until its block's last line is done.
SERVERS = {
    "yamsim view": (),
    "yamsim replay": ("--video",),
    "yamsim teleop": ("--input",),
    "yamsim serve-policy": (),
    "yamsim review": ("--merge", "--diff"),
}

# Pattern -> why a line with it is not run.
NOT_RUN = {
    r"^make\b": "it is what set this environment up, or what CI runs beside this test",
    r"^inspect-robots\b": "another program, which tests/clients/test_inspect.py runs in an environment of its own",
    r"^lerobot-": "another program, which tests/clients/test_lerobot_plugins.py runs in an environment of its own",
    r"--policy (act|ws|lerobot):": "another program's server, which tests/clients/test_policies.py has",
    r"^lerobot-train\b": "another program, which tests/clients/test_training.py runs in an environment of its own",
    r"^yamsim can-run\b": "it runs another program, as tests/clients/test_i2rt.py does in an environment of its own",
    r"--task abc/": "it needs a checkout of ABC, which tests/clients/test_abc_environment.py has",
    r"--task kitchenbench/": "it needs the benchmark; tests/kitchenbench/test_recorded.py records a scene of it",
    r"--out (varied|late_arms|by_friction|left_arm|handover|apples)\b": "tests/recorded_bytes.py has its like",
    r"--out recoveries\b": "tests/test_disturbed_motion.py records and verifies such an episode",
    r"\b(towers|folded)\b": "tests/e2e/test_program_recordings.py records and verifies these tasks",
    r"^yamsim trials --task tower": "a later line, `yamsim tasks check tower`, tries the same",
    r"^yamsim assets certify kitchen_": "another line certifies a mug; tests/objects/certify has all objects",
    r"^yamsim serve-robot (--rig yam_v1|--fault)": "tests/clients/test_i2rt.py serves arms with faults",
    r"^yamsim serve-robot .*--leader|--out performed\b|^yamsim-maker\b": "tests/clients/test_maker_station.py has it",
    r"^yamsim mcp\b": "an agent's program starts it, as tests/cli/test_mcp_command.py does",
    r"--selection dataset/selection.yaml|^yamsim review --merge": "a person decides first; see tests/test_selection.py",
    r"^yamsim review --diff": "it needs other datasets; tests/review/test_dataset_diff.py has some",
    r"^yamsim correct\b|--who\b": "tests/corrections records, merges and reads such a dataset",
    r"^yamsim (merge|split)\b": "it needs other datasets; tests/datasets/test_derive.py has some",
    r"picture_policy": "it needs PyTorch, with which tests/test_picture_policy.py runs these lines in miniature",
    r"^pip install\b": "it would change this environment; what is missing skips the test",
    r"^yamsim calibrate\b": "it needs larger pictures; tests/cli/test_calibrate_command.py has them",
    r"^yamsim export calibration\b": "it needs a calibration; tests/calibration/test_export_formats.py has one",
    r"^yamsim match\b|matched.yaml": "it needs photos of a station; tests/match/test_match.py renders some",
    r"--quality photo\b": "it takes minutes without a GPU; tests/photo_rendering/test_filament.py records with it",
    r"^yamsim identify log": "it takes minutes and a log of one; tests/real/identify has some",
    r"--robot my_arm": "it is of an arm that was measured; tests/core/robots/test_dynamics.py has one",
    r"^ray start\b": "it starts a cluster on this machine; test_ray_cluster.py has one",
    r"--address HEAD:6379": "there is no machine HEAD; test_ray_cluster.py records on a cluster of its own",
}


def reason_not_to_run(line: str) -> str | None:
    """Return why a line is not run; None if it is run."""
    return next((reason for pattern, reason in NOT_RUN.items() if re.search(pattern, line)), None)


def serves(line: str) -> bool:
    """Whether only a signal ends a line."""
    return any(
        line.startswith(begin) and not any(flag in shlex.split(line) for flag in ended_by)
        for begin, ended_by in SERVERS.items()
    )


def prepared(line: str, policy_port: int) -> str:
    """Return a line as a test runs it.

    Args:
        policy_port: a free port for a page's 8080.
    """
    for pattern, smaller in SMALLER.items():
        line = re.sub(pattern, smaller, line)
    line = re.sub(r"\b8080\b", str(policy_port), line)
    for begin, flags in CHEAPER.items():
        if line.startswith(begin):
            line = _with_flags(line, flags)
    return _with_flags(line, "--port 0") if serves(line) else line


def _with_flags(line: str, flags: str) -> str:
    """Return the line with the flags that it lacks, each with its value."""
    for flag in re.findall(r"--\S+(?: (?!--)\S+)?", flags):
        if flag.split()[0] not in shlex.split(line):
            line = f"{line} {flag}"
    return line
