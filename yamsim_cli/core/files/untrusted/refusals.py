from __future__ import annotations

from collections.abc import Mapping

# Code of a refusal -> its meaning.
REFUSAL_CODES: Mapping[str, str] = {
    "too-large": "the file, or a file that it names, has more bytes than an object needs",
    "too-many-files": "it names more files than an object needs",
    "too-many-faces": "it has, or declares, more faces than an object needs",
    "texture-too-large": "a texture has more pixels than an object needs",
    "texture-unreadable": "a texture is missing, or is not PNG or JPEG",
    "outside": "it names a file outside its own folder",
    "not-a-file": "a named file is a device, a pipe or a folder",
    "missing": "a named file does not exist",
    "unknown-kind": "the file name has no supported extension",
    "damaged": "the content does not match the format",
    "xml-entities": "the XML defines entities or a document type",
    "cycle": "it includes itself, or its frames refer to each other in a circle",
    "no-numbers": "coordinates are not finite numbers",
    "empty": "it has no surface",
    "several-things": "it contains more than one object",
    "joint-kind": "it has a joint that is not a hinge, slide or screw",
    "impossible": "a value in it is physically impossible",
    "too-slow": "reading took longer than is plausible for the size",
    "too-much-memory": "reading took more memory than is plausible for the size",
    "crashed": "the library that reads the file crashed",
    "size": "the object would be larger or smaller than anything that a hand can move",
    "unit": "the file does not state its unit",
    "up": "the file does not state its upward axis",
}


class RefusedError(Exception):
    """Refusal of an untrusted file, with one of `REFUSAL_CODES`."""

    def __init__(self, code: str, text: str) -> None:
        assert code in REFUSAL_CODES, code
        super().__init__(text)
        self.code = code
