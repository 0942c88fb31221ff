"""A photo on the table's surface."""

from __future__ import annotations

import mujoco

from .embedded_photos import decode_photo

TABLE_TOP_MATERIAL = "table_top"


def add_table_texture(spec: mujoco.MjSpec, photo: str, reflectance: float) -> str:
    """Add a material that shows a photo, and return its name.

    The photo's right is the table's +x, and its upper edge the table's +y, seen from above.
    """
    image = decode_photo(photo)
    texture = spec.add_texture(
        name=TABLE_TOP_MATERIAL,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=image.shape[1],
        height=image.shape[0],
        nchannel=3,
    )
    texture.data = image.tobytes()
    material = spec.add_material(
        name=TABLE_TOP_MATERIAL, specular=0.1, shininess=0.1, reflectance=reflectance, texuniform=False
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = TABLE_TOP_MATERIAL
    return TABLE_TOP_MATERIAL
