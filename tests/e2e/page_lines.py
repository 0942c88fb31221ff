"""How a test runs the commands on the pages: smaller sizes, servers, and commands that the test leaves out."""

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
    # Folders into which tests must not write.
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
    # In place of a user's files, the test has mugs with 24 sides, whose certificates fail.
    "yamsim assets import my_mug.glb": "--no-certify",
    "yamsim assets import scan.obj": "--no-certify",
}

# Start of a line -> flags. Without these flags, the command serves until a signal. It prints its URL first, and its
# exit code is 0 after SIGINT. The test ends it after the last line of its block.
SERVERS = {
    "yamsim view": (),
    "yamsim replay": ("--video",),
    "yamsim teleop": ("--input",),
    "yamsim serve-policy": (),
    "yamsim review": ("--merge", "--diff"),
}

# Pattern -> the reason why a test does not run lines with the pattern.
NOT_RUN = {
    r"^make\b": "it sets up this environment, or CI runs it as a separate step",
    r"^inspect-robots\b": "another program, which tests/clients/test_inspect.py runs in a separate environment",
    r"^lerobot-": "another program, which tests/clients/test_lerobot_plugins.py runs in a separate environment",
    r"--policy (act|ws|lerobot):": "it needs a server, which tests/clients/test_policies.py starts",
    r"^lerobot-train\b": "another program, which tests/clients/test_training.py runs in a separate environment",
    r"^yamsim can-run\b": "it runs another program; tests/clients/test_i2rt.py runs one in a separate environment",
    r"--task abc/": "it needs a checkout of ABC, with which tests/clients/test_abc_environment.py runs",
    r"--task kitchenbench/": "it needs the benchmark; tests/kitchenbench/test_recorded.py records a scene of it",
    r"--out (varied|late_arms|by_friction|left_arm|handover|apples)\b": "tests/recorded_bytes.py records similar data",
    r"--out recoveries\b": "tests/test_disturbed_motion.py records and verifies such an episode",
    r"\b(towers|folded)\b": "tests/e2e/test_program_recordings.py records and verifies these tasks",
    r"^yamsim trials --task tower": "a later line, `yamsim tasks check tower`, also runs trials of this task",
    r"^yamsim assets certify kitchen_": "another line certifies a mug; tests/objects/certify certifies all objects",
    r"^yamsim serve-robot (--rig yam_v1|--fault)": "tests/clients/test_i2rt.py serves arms with faults",
    r"^yamsim serve-robot .*--leader|--out performed\b|^yamsim-maker\b": "tests/clients/test_maker_station.py runs it",
    r"^yamsim mcp\b": "the program of an agent starts it; tests/cli/test_mcp_command.py starts it too",
    r"--selection dataset/selection.yaml|^yamsim review --merge": "a person decides; see tests/test_selection.py",
    r"^yamsim review --diff": "it needs several datasets; tests/review/test_dataset_diff.py compares some",
    r"^yamsim correct\b|--who\b": "tests/corrections records, merges and reads a dataset of corrections",
    r"^yamsim (merge|split)\b": "it needs several datasets; tests/datasets/test_derive.py merges and splits some",
    r"picture_policy": "it needs PyTorch; tests/test_picture_policy.py runs these lines at a smaller size",
    r"^pip install\b": "it would change this environment; tests skip lines whose packages are missing",
    r"^yamsim calibrate\b": "it needs larger pictures; tests/cli/test_calibrate_command.py renders them",
    r"^yamsim export calibration\b": "it needs a calibration; tests/calibration/test_export_formats.py exports one",
    r"^yamsim match\b|matched.yaml": "it needs photos of a station; tests/match/test_match.py renders some",
    r"--quality photo\b": "it takes minutes without a GPU; tests/photo_rendering/test_filament.py records with it",
    r"^yamsim identify log": "it needs minutes and a log of an arm; tests/real/identify runs it",
    r"--robot my_arm": "it needs the revision of a measured arm; tests/core/robots/test_dynamics.py has one",
    r"^ray start\b": "it starts a cluster on this machine; test_ray_cluster.py starts its own cluster",
    r"--address HEAD:6379": "there is no machine HEAD; test_ray_cluster.py records on its own cluster",
}


def reason_not_to_run(line: str) -> str | None:
    """Return the reason why a test does not run a line; None if it runs the line."""
    return next((reason for pattern, reason in NOT_RUN.items() if re.search(pattern, line)), None)


def serves(line: str) -> bool:
    """Whether only a signal ends the command of a line."""
    return any(
        line.startswith(begin) and not any(flag in shlex.split(line) for flag in ended_by)
        for begin, ended_by in SERVERS.items()
    )


def prepared(line: str, policy_port: int) -> str:
    """Return the line that a test runs in place of a line on a page.

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
