"""Programs that read output of yamsim: one row of docs/clients.md each, with its test."""

from __future__ import annotations

from dataclasses import dataclass, field

from tests.clients.environments import Environment


@dataclass(frozen=True)
class ClientRow:
    """A client.

    Attributes:
        client: name in the table.
        distribution: whose version the table shows.
        opens: its input, and what it does with the input.
        heavy: takes many minutes or gigabytes; only `make test-clients-heavy` runs it.
        checkout: variable with its repository's path, if no registry has it; its version is the commit.
    """

    client: str
    distribution: str
    opens: str
    environment: Environment = field(default_factory=Environment)
    heavy: bool = False
    checkout: str = ""


_SCENES = "`compose-xml`: all rigs and tasks load and come to rest; recorded episodes move as in MuJoCo 4"
_RRD = "`export rerun`: verified; joints, commands, images, cameras and poses equal the recorded ones"
_ENVS = "`yamsim/PickPlace-v0`: passes gymnasium's checker, and runs in separate processes, with images"
_VIDEOS = "writes yamsim's videos and exports: their tests pass as with the newest version"
_LEROBOT = (
    "`export lerobot`: all frames read; episodes deleted, split and merged; features removed; training starts on both"
)

# Key of the fixture `client` -> row.
ROWS: dict[str, ClientRow] = {
    "mujoco-3.3": ClientRow("MuJoCo 3.3", "mujoco", _SCENES, Environment("mujoco-3.3")),
    "mujoco-3.11": ClientRow("MuJoCo 3.11", "mujoco", _SCENES, Environment("mujoco-3.11"), heavy=True),
    "mujoco-3.17": ClientRow("MuJoCo 3.17", "mujoco", _SCENES, Environment("dm_control")),
    "mujoco-4": ClientRow(
        "MuJoCo 4",
        "mujoco",
        "`compose-xml`: all rigs and tasks load and come to rest; recorded episodes move as recorded",
    ),
    "dm_control": ClientRow(
        "dm_control",
        "dm_control",
        "`compose-xml`: parsed by `mjcf.from_path`, stepped (with MuJoCo 3.17); attaches rigs without boards",
        Environment("dm_control"),
    ),
    "raiden": ClientRow(
        client="TRI's raiden, from its repository",
        distribution="raiden",
        opens="`export raiden`: shards, shows and plays it by its own kinematics, and converts to the same frames",
        environment=Environment("raiden", python="3.11"),
        heavy=True,
        checkout="YAMSIM_RAIDEN",
    ),
    "rerun-0.30": ClientRow("rerun 0.30", "rerun-sdk", _RRD, Environment("rerun-0.30")),
    "rerun-0.41": ClientRow("rerun 0.41", "rerun-sdk", _RRD, Environment("rerun-0.41")),
    "gymnasium-1.0": ClientRow("gymnasium 1.0", "gymnasium", _ENVS, Environment("gymnasium-1.0", beside=True)),
    "gymnasium": ClientRow("gymnasium", "gymnasium", _ENVS),
    "inspect-robots": ClientRow(
        "Inspect Robots",
        "inspect-robots",
        "six KitchenBench tasks on yamsim's station: conforms, all 30 scenes at rest; the expert stacks two cups",
    ),
    "act": ClientRow(
        "inspect-robots-yam, json-numpy",
        "inspect-robots-yam",
        "`eval --policy act://`: a server with json_numpy gives the expert's trials; messages equal its client's",
        Environment("act"),
    ),
    "openpi": ClientRow(
        "openpi-client",
        "openpi-client",
        "`eval --policy ws://`: a server with openpi's packer gives the expert's trials",
        Environment("openpi"),
    ),
    "i2rt": ClientRow(
        "the maker's SDK, Dreamscale's build",
        "dreamscale-i2rt",
        "`serve-robot`, `can-run`: checks motors, calibrates the gripper, moves, holds and floats; the SDK's tools run",
        Environment("i2rt"),
    ),
    "portal": ClientRow(
        "portal",
        "portal",
        "`serve-robot --portal`: drives the arm with the calls of the maker's follower",
        Environment("i2rt"),
    ),
    "chiral": ClientRow(
        client="TRI's chiral, from its repository",
        distribution="chiral",
        opens="`serve-robot --chiral`: chiral's client moves both arms by joints and poses, and gets images",
        environment=Environment("chiral"),
        heavy=True,
        checkout="YAMSIM_CHIRAL",
    ),
    "raiden-cameras": ClientRow(
        client="raiden's cameras, from its repository",
        distribution="raiden",
        opens="`serve-robot --cameras`: images in its camera class; "
        "images of the right wrist are rotated like real images",
        environment=Environment("chiral"),
        heavy=True,
        checkout="YAMSIM_RAIDEN",
    ),
    "av-15": ClientRow("PyAV 15", "av", _VIDEOS, Environment("av-15", beside=True)),
    "av-16": ClientRow("PyAV 16", "av", _VIDEOS, Environment("av-16", beside=True), heavy=True),
    "av-17": ClientRow("PyAV 17", "av", _VIDEOS, Environment("av-17", beside=True), heavy=True),
    "lerobot": ClientRow(
        "LeRobot 0.6",
        "lerobot",
        f"{_LEROBOT}; shares an environment with `yamsim[lerobot,video]`; `eval --policy lerobot:` "
        "gives the same actions as LeRobot's own inference of a tiny ACT policy; `serve-robot --cameras`: images in "
        "its camera interface; "
        "`lerobot-train` with a small version of [the recipe](training.md): repeats a single demonstration",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
    "lerobot-eval": ClientRow(
        "LeRobot 0.6: lerobot-eval",
        "lerobot",
        "`lerobot_env_yamsim`: a policy that replays the expert succeeds in all trials, also in parallel; a policy "
        "trained by LeRobot runs, and its trials are recorded",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
    "lerobot-record": ClientRow(
        "LeRobot 0.6: lerobot-record, lerobot-replay",
        "lerobot",
        "`lerobot_robot_yamsim`: records episodes of the expert, which its loader reads; replays one in real time",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
    "lerobot-writes": ClientRow(
        "LeRobot 0.6: its own writer",
        "lerobot",
        "`import`: datasets of `LeRobotDataset.create`, with videos in AV1 or with images; its loader reads their "
        "`export lerobot`",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
    "raiden-records": ClientRow(
        client="raiden's recorder and sharder, from its repository",
        distribution="raiden",
        opens="`import`: its recordings of two arms; it shards the `export raiden` of real ones",
        environment=Environment("raiden", python="3.11"),
        heavy=True,
        checkout="YAMSIM_RAIDEN",
    ),
    "mcap": ClientRow(
        "mcap, foxglove-schemas-protobuf",
        "mcap",
        "`import`: files of their writers with the topics of ABC-130k, videos in H.264 and H.265",
        Environment("mcap"),
    ),
    "maker": ClientRow(
        client="the maker's yam-abc-reproduce, from its repository",
        distribution="yam-abc-reproduce",
        opens="`export maker`: its reader, the requests of its review tab and its converter to ABC; `import`: the "
        "episodes of its recorder, and the MCAP files of its converter",
        environment=Environment("maker", "3.12"),
        checkout="YAMSIM_MAKER",
    ),
    "maker-lerobot": ClientRow(
        client="the maker's converter to LeRobot, with LeRobot 0.6",
        distribution="yam-abc-reproduce",
        opens="`export maker`: the recorded numbers and images in LeRobot's loader",
        environment=Environment("lerobot", "3.12"),
        heavy=True,
        checkout="YAMSIM_MAKER",
    ),
    "maker-deploy": ClientRow(
        client="the maker's policy client, from its repository",
        distribution="yam-abc-reproduce",
        opens="`eval --policy-config maker_rtc`: a server gets the same requests from both, and both execute the same "
        "actions",
        environment=Environment("openpi", "3.12"),
        checkout="YAMSIM_MAKER",
    ),
    "maker-station": ClientRow(
        client="the maker's yam-abc-gui and yam-abc-deploy, from its repository",
        distribution="yam-abc-reproduce",
        opens="`serve-robot --cameras --leader`: the GUI finds cameras, arms and leaders, and collects the episode "
        "that the leaders perform; a policy server drives both arms, also with real-time chunking; the reports of both "
        "of a server that ends, a lost motor, lost frames and a camera that stops; its own tests pass",
        environment=Environment("maker-station", "3.12"),
        checkout="YAMSIM_MAKER",
    ),
    "abc-export": ClientRow(
        client="ABC's export_mcap.py, from its repository",
        distribution="abc-minimal",
        opens="`export abc`: the recorded rows from the second frame on, and the metadata of `--layout training`; "
        "`import`: its output",
        environment=Environment("maker", "3.12"),
        checkout="YAMSIM_ABC",
    ),
    "abc-loader": ClientRow(
        client="the dataset of ABC's trainer, from its repository",
        distribution="abc-minimal",
        opens="`export abc --layout training`: rows, action chunks, images and prompts of each usable frame",
        environment=Environment("lerobot", "3.12"),
        heavy=True,
        checkout="YAMSIM_ABC",
    ),
    "abc-environment": ClientRow(
        client="ABC's simulated evaluation, from its repository, without its renderer",
        distribution="abc-minimal",
        opens="`eval --task abc/put_bottles`: the starts of 200 seeds, the motion of bottles, and the verdict after "
        "each action of 200 sequences, with the same engine; the bottles that the expert puts into the bin",
        environment=Environment(),
        checkout="YAMSIM_ABC",
    ),
    "ros-cameras": ClientRow(
        client="ROS 2's parser of camera_info files (image_common), from its repository",
        distribution="camera_calibration_parsers",
        opens="`export calibration --format ros`: matrices, lens models and coefficients",
        checkout="YAMSIM_IMAGE_COMMON",
    ),
    "ros-transforms": ClientRow(
        client="ROS 2's static_transform_publisher (geometry2), from its repository, without its network",
        distribution="tf2_ros",
        opens="`export calibration --format ros`: the script publishes the calibrated poses",
        checkout="YAMSIM_GEOMETRY2",
    ),
    "kalibr": ClientRow(
        client="Kalibr's reader of camera chains, from its repository",
        distribution="kalibr",
        opens="`export calibration --format kalibr`: lenses, and poses from camera to camera; its camera models open",
        checkout="YAMSIM_KALIBR",
    ),
    "raiden-calibration": ClientRow(
        client="raiden's policy server, from its repository, without arms",
        distribution="raiden",
        opens="`export calibration --format raiden`: poses of fixed and wrist cameras and of the second base",
        checkout="YAMSIM_RAIDEN",
    ),
    "inspect-robots-bases": ClientRow(
        "inspect-robots-yam: collision check",
        "inspect-robots-yam",
        "`export calibration --format inspect_robots`: bases in its collision checker's model",
        Environment("act", beside=True),
    ),
    "lerobot-0.4": ClientRow("LeRobot 0.4", "lerobot", _LEROBOT, Environment("lerobot-0.4", "3.11"), heavy=True),
    "lerobot-doctor": ClientRow(
        "lerobot-doctor",
        "lerobot-doctor",
        "`export lerobot`: checked without a failure",
        Environment("lerobot", "3.12"),
        heavy=True,
    ),
}
