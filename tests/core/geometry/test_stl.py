import numpy as np
import pytest

from tests.meshes import ball, box, volume
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.geometry.stl import decode_stl, encode_stl


@pytest.mark.parametrize("surface", [box(), ball()])
def test_what_is_written_is_read_with_corners_shared_again(surface):
    vertices, faces = decode_stl(encode_stl(*surface))
    assert len(vertices) == len(surface[0])
    assert len(faces) == len(surface[1])
    np.testing.assert_allclose(vertices[faces], surface[0][surface[1]], atol=1e-7)
    assert volume((vertices, faces)) == pytest.approx(volume(surface), rel=1e-6)


def test_a_triangle_that_is_a_line_is_left_out():
    vertices, faces = box(cuts=1)
    flat = np.concatenate([faces, [[0, 0, 1]]])
    assert len(decode_stl(encode_stl(vertices, flat))[1]) == len(faces)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"solid cube\nfacet normal 0 0 1\n" * 8,
        encode_stl(*box())[:-1],
        encode_stl(*box()) + b"\0",
        bytes(80) + (0).to_bytes(4, "little"),
        encode_stl(*box())[:96] + np.float32(np.inf).tobytes() + encode_stl(*box())[100:],
    ],
)
def test_a_file_that_is_not_a_binary_stl_is_refused(data):
    with pytest.raises(ResourceError, match="STL"):
        decode_stl(data)
