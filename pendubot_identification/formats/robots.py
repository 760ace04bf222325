# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The links of a rig with given parameters, and its MJCF and URDF, for simulators and RViz.

P1 to P5 leave two of the links' seven numbers free. P3 / P5 is the length l1 of link 1. Any m2 between P5^2 / P2 and
P1 / l1^2, and any m1 above (P4 - m2 l1)^2 / (P1 - m2 l1^2), gives positive inertias and the same motion.

In all files the shoulder is the origin, z points up, both joints turn about -y, and both angles are 0 with the arm
along x: q1 is measured from the horizontal, q2 relative to link 1. The motion depends only on a link's inertia about
the joint axes; the files give this value for all axes.
"""

import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.dynamics import GRAVITY, SIGN_WIDTH
from pendubot_identification.model.parameters import Parameters


@dataclass(frozen=True, slots=True)
class Link:
    """A link: length [m], mass [kg], distance of the centre of mass from the joint [m], inertia about it [kg m^2]."""

    length: float
    mass: float
    centre: float
    inertia: float


@dataclass(frozen=True, slots=True)
class Rig:
    """Both links, their parameters, and sentences on the choices."""

    first: Link
    second: Link
    parameters: Parameters
    choices: tuple[str, ...]


def rig_of(parameters: Parameters, link_length: float | None = None) -> Rig:
    """Return a rig with these parameters; parameters of two equal uniform rods give these rods.

    ``link_length`` is the measured length of link 1 [m], and P3 becomes P5 times it; None: P3 / P5.

    Raises:
        ParameterError: no real masses give these parameters.
    """
    p = Parameters(*map(float, astuple(parameters)))
    if problems := p.unphysical():
        raise ParameterError(f'no rig has these parameters: {problems[0]}; identify the rig again')
    if link_length is None:
        if not p.P3 * p.P5 > 0:
            found = f'P3 = {p.P3:.4g} and P5 = {p.P5:.4g}'
            raise ParameterError(f'{found} give link 1 no length P3 / P5 above 0; measure it and add --link-length')
        l1 = p.P3 / p.P5
        chosen = f'link 1 is {l1:.6g} m long: P3 / P5'
    else:
        l1, limit = float(link_length), math.sqrt(p.P1 * p.P2) / abs(p.P5) if p.P5 else math.inf
        if not 0 < l1 < limit:
            below = f' and below sqrt(P1 P2) / |P5| = {limit:.4g} m' if p.P5 else ''
            raise ParameterError(
                f'no real masses give these parameters with a link 1 of {l1:g} m; a length above 0{below} is expected'
            )
        p = replace(p, P3=p.P5 * l1)
        chosen = f'link 1 is {l1:.6g} m long, as given: P3 is P5 l1 = {p.P3:.6g} kg m^2, not {parameters.P3:.6g}'
    low, high = p.P5**2 / p.P2, p.P1 / l1**2
    # Two equal uniform rods have this geometric mean, and an m1 of 3/4 inertia / l1^2 above its lower limit.
    m2 = math.sqrt(low * high) or high / 2
    moment, inertia, second = p.P4 - m2 * l1, p.P1 - m2 * l1**2, p.P2 - p.P5**2 / m2
    if not min(inertia, second) > 0:
        raise ParameterError(f'P1 P2 = {p.P1 * p.P2:.17g} exceeds P3^2 by rounding alone; identify the rig again')
    least, more = moment**2 / inertia, 0.75 * inertia / l1**2
    m1 = least + more
    # The length of link 2 is only drawn; a uniform rod has this length.
    l2 = min(1.5 * p.P2 / abs(p.P5), 3 * l1) if p.P5 else l1
    choices = (
        chosen,
        f'm2 = {m2:.6g} kg and m1 = {m1:.6g} kg are chosen: with any m2 from {low:.4g} to {high:.4g} kg, and with this '
        f'm2 any m1 above {least:.4g} kg, the rig moves in the same way',
        f'link 2 is drawn {l2:.4g} m long; its motion does not depend on this length',
    )
    return Rig(Link(l1, m1, moment / m1, inertia * more / m1), Link(l2, m2, p.P5 / m2, second), p, choices)


#: A link's radius over the length of the shorter one.
SLENDER = 0.05
#: MuJoCo's time step [s].
TIME_STEP = 0.002
STEEL, BLUE, ORANGE = '0.45 0.48 0.52 1', '0.12 0.35 0.65 1', '0.85 0.42 0.10 1'


def limits(parameters: Parameters, *, armature: bool) -> list[str]:
    """Return sentences on the effects of these parameters that such a file does not represent."""
    p, missing = parameters, []
    if p.Fc1 or p.Fc2:
        missing.append(
            'dry friction is constant in simulators, and holds a link at rest; the identified dry friction is '
            f'Fc tanh(v / {SIGN_WIDTH:g})'
        )
    if left := [f'{name} = {value:.4g}' for name in ('Fs1', 'Fs2', 'k1', 'k2') if (value := getattr(p, name))]:
        missing.append(f'{", ".join(left)} is left out: such a file has only Coulomb and viscous friction')
    if p.J2 and not armature:
        missing.append(
            f'J2 = {p.J2:.6g} kg m^2 is left out: make it the armature (rotor inertia) of the elbow in the '
            'simulator, or export mjcf'
        )
    return missing


def mjcf(rig: Rig, comments: Iterable[str] = (), torque_limit: float | None = None, delay: float = 0.0) -> str:
    """Return the MJCF of a rig with a motor delay [s], if it is a time step or more; both keyframes are at rest."""
    p, radius = rig.parameters, SLENDER * min(rig.first.length, rig.second.length)
    limit = '' if torque_limit is None else f' ctrllimited="true" ctrlrange="{-torque_limit!r} {torque_limit!r}"'
    late = f' delay="{delay!r}" nsample="{math.ceil(delay / TIME_STEP) + 1}"' if delay >= TIME_STEP else ''

    def joint(name: str, damping: float, dry: float, armature: float) -> str:
        more = [f' {key}="{value!r}"' for key, value in (('frictionloss', dry), ('armature', armature)) if value]
        return f'<joint name="{name}" type="hinge" axis="0 -1 0" damping="{damping!r}"{"".join(more)}/>'

    def inertial(link: Link) -> str:
        about = ' '.join([repr(link.inertia)] * 3)
        return f'<inertial pos="{link.centre!r} 0 0" mass="{link.mass!r}" diaginertia="{about}"/>'

    def geom(link: Link, aside: float, colour: str) -> str:
        ends = f'0 {aside:.6g} 0 {link.length!r} {aside:.6g} 0'
        shape = f'type="capsule" fromto="{ends}" size="{radius:.6g}"'
        return f'<geom {shape} rgba="{colour}" contype="0" conaffinity="0"/>'

    return f"""\
<?xml version="1.0"?>
{_comment(comments)}<mujoco model="pendubot">
  <compiler angle="radian"/>
  <!-- MuJoCo's other integrators are off by 0.05 rad after a second (median of 100 rigs), this one by 4e-8. -->
  <option timestep="{TIME_STEP}" integrator="RK4" gravity="0 0 {-GRAVITY!r}"/>
  <worldbody>
    <light pos="0 -2 2" dir="0 1 -1"/>
    <body name="link_1">
      {joint('shoulder', p.b1, p.Fc1, 0.0)}
      {inertial(rig.first)}
      {geom(rig.first, 0.0, BLUE)}
      <body name="link_2" pos="{rig.first.length!r} 0 0">
        {joint('elbow', p.b2, p.Fc2, p.J2)}
        {inertial(rig.second)}
        {geom(rig.second, -2.2 * radius, ORANGE)}
        <site name="tip" pos="{rig.second.length!r} 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder"{limit}{late}/>
  </actuator>
  <keyframe>
    <key name="hanging" qpos="{-math.pi / 2!r} 0"/>
    <key name="upright" qpos="{math.pi / 2!r} 0"/>
  </keyframe>
</mujoco>
"""


def urdf(rig: Rig, comments: Iterable[str] = (), torque_limit: float | None = None, *, revolute: bool = False) -> str:
    """Return the URDF of a rig, for RViz and simulators; a link without mass is for display only.

    Joints are ``continuous`` or, with limits that are never reached, ``revolute``.
    """
    p, radius = rig.parameters, SLENDER * min(rig.first.length, rig.second.length)
    efforts = (1000.0, 1000.0) if torque_limit is None else (torque_limit, 0.0)

    def joint(name: str, parent: str, child: str, x: float, damping: float, friction: float, effort: float) -> str:
        limit = ''
        if torque_limit is not None or revolute:
            # A limit has to have a speed and an effort; 1000 limits nothing. The elbow has no motor.
            travel = ' lower="-1000" upper="1000"' if revolute else ''
            limit = f'\n    <limit{travel} effort="{effort!r}" velocity="1000"/>'
        return f"""\
<joint name="{name}" type="{'revolute' if revolute else 'continuous'}">
    <parent link="{parent}"/>
    <child link="{child}"/>
    <origin xyz="{x!r} 0 0" rpy="0 0 0"/>
    <axis xyz="0 -1 0"/>
    <dynamics damping="{damping!r}" friction="{friction!r}"/>{limit}
  </joint>"""

    def inertial(link: Link) -> str:
        return f"""
    <inertial>
      <origin xyz="{link.centre!r} 0 0"/>
      <mass value="{link.mass!r}"/>
      <inertia ixx="{link.inertia!r}" iyy="{link.inertia!r}" izz="{link.inertia!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>"""

    def cylinder(xyz: str, rpy: str, radius: float, length: float, material: str, colour: str) -> str:
        return f"""
    <visual>
      <origin xyz="{xyz}" rpy="{rpy}"/>
      <geometry><cylinder radius="{radius:.6g}" length="{length!r}"/></geometry>
      <material name="{material}"><color rgba="{colour}"/></material>
    </visual>"""

    along, across = '0 1.5707963267948966 0', '1.5707963267948966 0 0'
    l1, l2 = rig.first.length, rig.second.length
    base = cylinder(f'0 {3.2 * radius:.6g} 0', across, 2 * radius, 4 * radius, 'steel', STEEL)
    first = cylinder(f'{l1 / 2!r} 0 0', along, radius, l1, 'blue', BLUE)
    # Link 2 moves in front of link 1, so that it can go round.
    second = cylinder(f'{l2 / 2!r} {-2.2 * radius:.6g} 0', along, radius, l2, 'orange', ORANGE)
    return f"""\
<?xml version="1.0"?>
{_comment(comments)}<robot name="pendubot">
  <link name="base_link">{base}
  </link>
  {joint('shoulder', 'base_link', 'link_1', 0.0, p.b1, p.Fc1, efforts[0])}
  <link name="link_1">{inertial(rig.first) if rig.first.mass else ''}{first}
  </link>
  {joint('elbow', 'link_1', 'link_2', l1, p.b2, p.Fc2, efforts[1])}
  <link name="link_2">{inertial(rig.second) if rig.second.mass else ''}{second}
  </link>
  <joint name="tip_joint" type="fixed">
    <parent link="link_2"/>
    <child link="tip"/>
    <origin xyz="{l2!r} 0 0" rpy="0 0 0"/>
  </joint>
  <link name="tip"/>
</robot>
"""


def drawn(l1: float, l2: float) -> str:
    """Return a URDF for display, without masses, of links of these lengths [m]. May raise ParameterError."""
    for name, length in (('l1', l1), ('l2', l2)):
        if not 0 < length < math.inf:
            raise ParameterError(f'the length {name} is {length:g} m; a number above 0 is expected')
    first, second = (Link(length, 0.0, 0.0, 0.0) for length in (l1, l2))
    return urdf(Rig(first, second, Parameters(*[0.0] * 7), ()), ['a pendubot for display: it has no masses'])


def _comment(lines: Iterable[str]) -> str:
    """Return lines as a comment, in which XML allows no two hyphens."""
    text = ''.join(f'  {line}\n' for line in lines)
    while '--' in text:
        text = text.replace('--', '- -')
    return f'<!--\n{text}-->\n'
