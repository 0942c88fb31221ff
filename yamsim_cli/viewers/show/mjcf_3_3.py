"""The part of MuJoCo 3.3's MJCF that composed scenes use, and the differences in newer versions.

Source: `mujoco.mj_printSchema` and the compiled defaults of the releases named below.
"""

from __future__ import annotations

from collections.abc import Mapping

_POSE = "pos quat axisangle euler xyaxes zaxis"
_SOLVER = "solref solimp"
_JOINT_SOLVER = "solreflimit solimplimit solreffriction solimpfriction"

# Section and element -> the attributes that all versions from 3.3.0 to 4.0.0 read. Bodies may contain bodies, and
# `default` classes may contain classes. In a class, an element has the same attributes. `gap` is left out, since its
# meaning changed in 3.9.
ATTRIBUTES: Mapping[str, frozenset[str]] = {
    element: frozenset(names.split())
    for element, names in {
        "mujoco": "model",
        "compiler": "alignfree angle autolimits balanceinertia boundinertia boundmass discardvisual eulerseq "
        "fitaabb fusestatic inertiafromgeom inertiagrouprange meshdir settotalmass strippath texturedir usethread",
        "option": "timestep gravity wind magnetic density viscosity impratio integrator cone jacobian solver "
        "iterations tolerance ls_iterations ls_tolerance noslip_iterations noslip_tolerance ccd_iterations "
        "ccd_tolerance sdf_iterations sdf_initpoints actuatorgroupdisable o_margin o_solref o_solimp o_friction",
        "option/flag": "actuation autoreset clampctrl constraint contact energy equality eulerdamp filterparent "
        "frictionloss fwdinv gravity invdiscrete island limit midphase multiccd nativeccd override refsafe sensor "
        "warmstart",
        "size": "memory nconmax njmax nkey nuserdata",
        "visual": "",
        "visual/global": "azimuth bvactive elevation ellipsoidinertia fovy glow ipd linewidth offheight offwidth "
        "orthographic realtime",
        "visual/quality": "numquads numslices numstacks offsamples shadowsize",
        "visual/headlight": "active ambient diffuse specular",
        "visual/map": "actuatortendon alpha fogend fogstart force haze shadowclip shadowscale stiffness "
        "stiffnessrot torque zfar znear",
        "statistic": "center extent meaninertia meanmass meansize",
        "default": "class",
        "asset": "",
        "asset/mesh": "name class file content_type scale inertia refpos refquat maxhullvert smoothnormal vertex "
        "normal texcoord face",
        "asset/texture": "name type file content_type builtin rgb1 rgb2 mark markrgb random width height nchannel "
        "hflip vflip gridsize gridlayout fileback filedown filefront fileleft fileright fileup",
        "asset/material": "name class texture texrepeat texuniform rgba emission specular shininess reflectance "
        "metallic roughness",
        "worldbody": "",
        "worldbody/body": f"name childclass mocap gravcomp user {_POSE}",
        "worldbody/inertial": f"mass diaginertia fullinertia {_POSE}",
        "worldbody/joint": "name class type axis pos range limited ref springref springdamper stiffness damping "
        "armature frictionloss margin group user actuatorfrclimited actuatorfrcrange actuatorgravcomp "
        f"{_JOINT_SOLVER}",
        "worldbody/freejoint": "name group align",
        "worldbody/geom": "name class type size fromto mesh hfield material rgba group contype conaffinity condim "
        f"friction solmix margin priority mass density shellinertia fitscale fluidshape fluidcoef user {_SOLVER} "
        f"{_POSE}",
        "worldbody/site": f"name class type size fromto material rgba group user {_POSE}",
        "worldbody/camera": "name class mode target fovy ipd focal focalpixel principal principalpixel sensorsize "
        f"resolution user {_POSE}",
        "worldbody/light": "name class mode target pos dir directional castshadow active ambient diffuse specular "
        "attenuation cutoff exponent bulbradius",
        "contact": "",
        "contact/exclude": "name body1 body2",
        "contact/pair": f"name class geom1 geom2 condim friction margin solreffriction {_SOLVER}",
        "equality": "",
        "equality/connect": f"name class active anchor body1 body2 site1 site2 {_SOLVER}",
        "equality/weld": f"name class active anchor relpose torquescale body1 body2 site1 site2 {_SOLVER}",
        "equality/joint": f"name class active joint1 joint2 polycoef {_SOLVER}",
        "tendon": "",
        "tendon/spatial": "name class group limited range frictionloss springlength stiffness damping width material "
        "rgba margin user solreflimit solimplimit",
        "tendon/site": "site",
        "tendon/fixed": "name class group limited range springlength stiffness damping frictionloss margin user "
        " solreflimit solimplimit solreffriction solimpfriction",
        "tendon/joint": "joint coef",
        "actuator": "",
        "actuator/general": "name class joint jointinparent tendon site refsite body slidersite cranksite "
        "cranklength gear group lengthrange ctrlrange ctrllimited forcerange forcelimited actrange actlimited actdim "
        "actearly dyntype dynprm gaintype gainprm biastype biasprm user",
        "keyframe": "",
        "keyframe/key": "name time qpos qvel act ctrl mpos mquat",
    }.items()
}

# Element inside a `default` class -> the key of its attributes in `ATTRIBUTES`.
CLASS_ELEMENTS: Mapping[str, str] = {
    **{name: f"worldbody/{name}" for name in ("joint", "geom", "site", "camera", "light")},
    **{name: f"asset/{name}" for name in ("mesh", "material")},
    "pair": "contact/pair",
    "equality": "equality/weld",
    "general": "actuator/general",
}

# Attributes with fewer values in 3.3: element -> attribute -> the values that 3.3 reads.
ATTRIBUTE_VALUES: Mapping[str, Mapping[str, frozenset[str]]] = {
    # In 3.3, signed distance fields need a plugin.
    "worldbody/geom": {
        "type": frozenset({"plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh"})
    },
    "option": {"integrator": frozenset({"Euler", "RK4", "implicit", "implicitfast"})},
}

# Attributes after 3.3 that may be left out: element -> attribute -> the harmless values, or None for all values.
# Leaving out `castshadow` of geoms (4.0) or `colorspace` (3.3.3) changes only the appearance. `input="pos"` (4.0) only
# names the single control of an actuator; gain and bias determine the rest. MuJoCo applies `inheritrange` of `general`
# (3.16) before it writes the file.
OPTIONAL_ATTRIBUTES: Mapping[str, Mapping[str, frozenset[str] | None]] = {
    "worldbody/geom": {"castshadow": None},
    "asset/texture": {"colorspace": None},
    "actuator/general": {"input": frozenset({"pos"}), "inheritrange": None},
}
