"""The well-known Ant as a yardstick: a torso on four legs of two joints each, on a floor without walls."""

from __future__ import annotations

import mujoco

HIP, REACH, FOOT = 0.2, 0.2, 0.4
"""Metres along x and y from the torso to a hip, from a hip to a knee, and from a knee to a foot."""
CONTACTS = 25
"""Points at which its geoms can touch the floor: two of each of twelve capsules, one of the torso."""


def ant(timestep: float = 0.005, iterations: int = 20) -> mujoco.MjModel:
    """The Ant: 15 coordinates (14 degrees of freedom), 8 motors; keyframe 0 has it above the floor, its legs bent.

    Args:
        timestep: physics step in seconds.
        iterations: of the solver, and of its line searches.
    """
    legs = [_leg(f"leg{i}", x, y) for i, (x, y) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)])]
    motors = [f'<motor joint="leg{i}:{name}"/>' for i in range(len(legs)) for name in ("hip", "ankle")]
    return mujoco.MjModel.from_xml_string(f"""<mujoco model="ant">
      <option timestep="{timestep}" iterations="{iterations}" ls_iterations="{iterations}" solver="Newton"/>
      <default>
        <joint armature="1" damping="1" limited="true"/>
        <geom contype="0" conaffinity="1" density="5" margin="0.01" friction="1 0.5 0.5"/>
        <motor gear="150" ctrlrange="-1 1" ctrllimited="true"/>
      </default>
      <worldbody>
        <geom name="floor" type="plane" size="40 40 1" contype="1" conaffinity="0"/>
        <body name="torso" pos="0 0 0.75">
          <freejoint name="root"/>
          <geom name="torso" size="0.25"/>
          {"".join(legs)}
        </body>
      </worldbody>
      <actuator>{"".join(motors)}</actuator>
      <keyframe><key qpos="0 0 0.75 1 0 0 0 {" 0 1" * len(legs)}"/></keyframe>
    </mujoco>""")


def _leg(name: str, x: int, y: int) -> str:
    """One leg towards the corner (x, y); its ankle bends about the horizontal across it, downwards."""
    hip, reach, foot = (f"{d * x} {d * y} 0" for d in (HIP, REACH, FOOT))
    return f"""
      <geom type="capsule" fromto="0 0 0 {hip}" size="0.08"/>
      <body name="{name}" pos="{hip}">
        <joint name="{name}:hip" axis="0 0 1" range="-30 30"/>
        <geom type="capsule" fromto="0 0 0 {reach}" size="0.08"/>
        <body name="{name}:shin" pos="{reach}">
          <joint name="{name}:ankle" axis="{-y} {x} 0" range="30 70"/>
          <geom name="{name}:foot" type="capsule" fromto="0 0 0 {foot}" size="0.08"/>
        </body>
      </body>"""
