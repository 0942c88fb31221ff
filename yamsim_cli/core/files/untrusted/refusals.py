from __future__ import annotations

from collections.abc import Mapping

# Code of a refusal -> its meaning.
CODES: Mapping[str, str] = {
    "too-large": "the file, or one that it names, has more bytes than a thing needs",
    "too-many-files": "it names more files than a thing needs",
    "too-many-faces": "it has more faces than a thing needs, or says so",
    "texture-too-large": "a texture has more pixels than a thing needs",
    "texture-unreadable": "a texture is missing, or no PNG or JPEG",
    "outside": "it names a file that does not lie in its own folder",
    "not-a-file": "what it names is a device, a pipe or a folder",
    "missing": "a file that it names is not there",
    "unknown-kind": "the name ends in nothing that can be read",
    "damaged": "the content is not what the format asks for",
    "xml-entities": "the XML defines entities or a document type",
    "cycle": "it includes itself, or its frames refer to each other in a circle",
    "no-numbers": "coordinates are not finite numbers",
    "empty": "it has no surface",
    "several-things": "it holds more than one thing",
    "joint-kind": "it has a joint that is no hinge, slide or screw",
    "impossible": "a figure in it is none that a thing can have",
    "too-slow": "reading took longer than its size deserves",
    "too-much-memory": "reading took more memory than its size deserves",
    "crashed": "the library that reads it broke down over it",
    "size": "the thing would be larger or smaller than anything that a hand can move",
    "unit": "the file does not say its unit",
    "up": "the file does not say which way is up",
}


class RefusedError(Exception):
    """Refusal of an untrusted file, with one of `CODES`."""

    def __init__(self, code: str, text: str) -> None:
        assert code in CODES, code
        super().__init__(text)
        self.code = code
