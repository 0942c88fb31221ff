"""The MJCF of MuJoCo 3.3, as far as composed scenes use it, and the differences of newer versions.

Source: `mujoco.mj_printSchema` and the compiled defaults of the releases named below.
"""

from __future__ import annotations

from collections.abc import Mapping

_POSE = "pos quat axisangle euler xyaxes zaxis"
_SOLVER = "solref solimp"
_JOINT_SOLVER = "solreflimit solimplimit solreffriction solimpfriction"

# Section and element -> the attributes that 3.3.0 and all later versions up to 4.0.0 read. Bodies may hold bodies, and
# classes may hold classes. An element's attributes in a class are the element's own. `gap` is left out: its meaning
# changed in 3.9.
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

# Element in a class -> the key of `ATTRIBUTES` with its attributes.
CLASS_ELEMENTS: Mapping[str, str] = {
    **{name: f"worldbody/{name}" for name in ("joint", "geom", "site", "camera", "light")},
    **{name: f"asset/{name}" for name in ("mesh", "material")},
    "pair": "contact/pair",
    "equality": "equality/weld",
    "general": "actuator/general",
}

# Attributes for which 3.3 knows fewer values: element -> attribute -> the values that it reads.
VALUES: Mapping[str, Mapping[str, frozenset[str]]] = {
    # Distances to a mesh need a plugin there.
    "worldbody/geom": {
        "type": frozenset({"plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh"})
    },
    "option": {"integrator": frozenset({"Euler", "RK4", "implicit", "implicitfast"})},
}

# Attributes that came after 3.3 and may be left out: element -> attribute -> the values for which that changes only
# looks, or None for all values. `castshadow` of geoms (4.0) and `colorspace` (3.3.3) are looks. `input="pos"` (4.0)
# only names an actuator's single control, and its gain and bias hold everything else. `inheritrange` of `general`
# (3.16) is already worked out when MuJoCo writes the file.
OPTIONAL: Mapping[str, Mapping[str, frozenset[str] | None]] = {
    "worldbody/geom": {"castshadow": None},
    "asset/texture": {"colorspace": None},
    "actuator/general": {"input": frozenset({"pos"}), "inheritrange": None},
}
