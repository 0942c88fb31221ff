"""A rack: a plate of 20 cm with a rail on either side, in SDFormat."""

from __future__ import annotations

_PARTS = {
    "plate": ("0 0 0.006", "0.2 0.2 0.012", "0.6 0.4 0.2 1"),
    "rail_l": ("0 0.095 0.016", "0.2 0.01 0.032", "0.3 0.3 0.35 1"),
    "rail_r": ("0 -0.095 0.016", "0.2 0.01 0.032", "0.3 0.3 0.35 1"),
}


def rack_sdf() -> str:
    parts = []
    for name, (at, size, rgba) in _PARTS.items():
        body = f"<pose>{at} 0 0 0</pose><geometry><box><size>{size}</size></box></geometry>"
        parts.append(f'<visual name="{name}">{body}<material><diffuse>{rgba}</diffuse></material></visual>')
        parts.append(f'<collision name="{name}">{body}</collision>')
    weight = "<mass>1.5</mass><inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.02</izz></inertia>"
    inertial = f"<inertial><pose>0 0 0.008 0 0 0</pose>{weight}</inertial>"
    link = f'<link name="rack">{inertial}{"".join(parts)}</link>'
    return f'<sdf version="1.9"><model name="my_rack">{link}</model></sdf>\n'
