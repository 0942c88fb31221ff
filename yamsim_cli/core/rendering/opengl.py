"""OpenGL functions of the current platform's library, called without PyOpenGL's checks.

A frame needs several hundred calls. PyOpenGL queries the error state after each call, which takes longer than the call.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FLOAT, _DOUBLE, _INT, _ENUM, _BOOL = ctypes.c_float, ctypes.c_double, ctypes.c_int, ctypes.c_uint, ctypes.c_ubyte
_POINTER = ctypes.c_void_p

# Names of functions -> types of their arguments, as in OpenGL's specification.
_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "glEndList glLoadIdentity glPopMatrix glPushMatrix": (),
    "glActiveTexture glCallList glClear glCullFace glDepthFunc glDisable glDisableClientState glDrawBuffer": (_ENUM,),
    "glEnable glEnableClientState glMatrixMode glShadeModel": (_ENUM,),
    "glBindFramebuffer glBindTexture glBlendFunc glNewList": (_ENUM, _ENUM),
    "glGenLists": (_INT,),
    "glDeleteProgram glUseProgram": (_ENUM,),
    "glUniformMatrix4fv": (_INT, _INT, _BOOL, _POINTER),
    "glDeleteLists": (_ENUM, _INT),
    "glDrawArrays": (_ENUM, _INT, _INT),
    "glScissor glViewport": (_INT,) * 4,
    "glColorMask": (_BOOL,) * 4,
    "glColor4f": (_FLOAT,) * 4,
    "glScalef glTranslatef": (_FLOAT,) * 3,
    "glPolygonOffset": (_FLOAT, _FLOAT),
    "glOrtho": (_DOUBLE,) * 6,
    "glMaterialf": (_ENUM, _ENUM, _FLOAT),
    "glMultMatrixf": (_POINTER,),
    "glGetFloatv": (_ENUM, _POINTER),
    "glMaterialfv glTexGenfv": (_ENUM, _ENUM, _POINTER),
    "glNormalPointer": (_ENUM, _INT, _POINTER),
    "glTexCoordPointer glVertexPointer": (_INT, _ENUM, _INT, _POINTER),
}


class OpenGlFunctions:
    """The functions of `_ARGUMENTS` as attributes. An OpenGL context must be current when one is called.

    Raises:
        AttributeError: the platform's library lacks a function.
    """

    def __init__(self) -> None:
        # On import, PyOpenGL binds to the platform of the existing context.
        from OpenGL import platform

        library = platform.PLATFORM.GL
        for names, arguments in _ARGUMENTS.items():
            for name in names.split():
                function = library._FuncPtr((name, library))  # in the calling convention of the platform
                function.argtypes = arguments
                function.restype = _ENUM if name == "glGenLists" else None
                setattr(self, name, function)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{name} is not among the OpenGL functions in use")


def address(values: NDArray[np.float32]) -> int:
    """Return the address of an array's first element, for an argument of OpenGL."""
    return int(values.ctypes.data)


def floats(*values: float) -> NDArray[np.float32]:
    """Return numbers as an array in single precision, in which OpenGL reads them."""
    return np.array(values, np.float32)
