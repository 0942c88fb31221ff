"""Fewest faces of each mesh: the source of the reductions in assets.lock.json.

    python -m tools.bench.reduction [model2.stl ...]

Slow: each try is rendered and measured. The lock has a file's smallest count, and slivers_mm unless that is 0.1.
"""

from __future__ import annotations

import os
import sys

from yamsim_cli.gl import find_backend

# Targets, a little stricter than the tests' limits (0.5 mm and 0.995).
FARTHEST_MM = 0.475
LEAST_OVERLAP = 0.9952
SLIVERS_MM = (0.0, 0.05, 0.08, 0.1)
SAMPLES = 20_000


def main() -> None:
    """Search by bisection, for every tolerance of slivers, and print the results."""
    os.environ.setdefault("MUJOCO_GL", find_backend(os.environ).name or "")

    from tests.silhouettes import Silhouettes, overlap
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.core.geometry.stl import decode_stl
    from yamsim_cli.core.geometry.surface_distance import hausdorff_distance
    from yamsim_cli.core.scene.assets import AssetStore, Reduction, load_lock
    from yamsim_cli.core.scene.assets.mesh_reduction import collapse_edges, remove_slivers

    where = Locations.from_environment(os.environ)
    store = AssetStore(where.assets)
    for assets in load_lock(where).sets.values():
        folder = store.find_verified_folder(assets)
        if folder is None:
            print(f"{assets.name}: not here, run yamsim assets fetch")
            continue
        for file in (name for name in assets.files if not sys.argv[1:] or name in sys.argv[1:]):
            vertices, faces = decode_stl((folder / file).read_bytes())
            source = vertices * 1000, faces
            camera = Silhouettes(source[0])
            outlines = camera.of(*source)
            print(f"{file}: {len(faces)} faces")
            for slivers in SLIVERS_MM:
                low, high, best = 40, len(remove_slivers(source, slivers)[1]), "nothing fits"
                while high - low > max(16, 0.02 * low):
                    middle = (low + high) // 2
                    reduced = collapse_edges(source, Reduction(faces=middle, slivers_mm=slivers))
                    far = hausdorff_distance(source, reduced, 1.0, SAMPLES)
                    same = overlap(outlines, camera.of(*reduced)) if far <= FARTHEST_MM else 0.0
                    if same >= LEAST_OVERLAP:
                        high, best = min(middle, len(reduced[1])), f"{len(reduced[1])} faces, {far:.3f} mm, {same:.4f}"
                    else:
                        low = middle
                print(f"    slivers_mm {slivers}: {best}", flush=True)


if __name__ == "__main__":
    main()
