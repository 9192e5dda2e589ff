"""A small crane of boxes."""

from __future__ import annotations

import pytest

from pwralign_kin.model import ArticulatedModel

URDF = """<robot name="crane">
  <link name="base"><visual><geometry><box size="0.6 0.4 0.2"/></geometry></visual></link> <link
  name="tower"><visual><origin xyz="0 0 0.3"/><geometry><box size="0.12 0.12 0.6"/></geometry></visual></link>
  <link name="boom"><visual><origin xyz="0.3 0 0"/><geometry><box size="0.7 0.1
  0.1"/></geometry></visual></link> <link name="hook"><visual><geometry><cylinder radius="0.06"
  length="0.2"/></geometry></visual></link> <joint name="turn" type="revolute"><parent link="base"/><child
  link="tower"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="lift" type="revolute"><parent link="tower"/><child link="boom"/><origin xyz="0 0 0.6"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="boom"/><child link="hook"/><origin xyz="0.3 0 -0.15"/>
    <axis xyz="1 0 0"/><limit lower="-0.1" upper="0.2" effort="1" velocity="1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> ArticulatedModel:
    path = tmp_path_factory.mktemp("crane") / "crane.urdf"
    path.write_text(URDF)
    return ArticulatedModel.from_urdf(path)
