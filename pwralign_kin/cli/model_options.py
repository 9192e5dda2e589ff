"""How a URDF is read, for every verb that takes one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from pwralign_kin.cli.arguments import MODEL
from pwralign_kin.cli.codes import UsageError

if TYPE_CHECKING:
    from pwralign_kin.model import ArticulatedModel

Urdf = Annotated[Path, Parameter(help="The model: a URDF file (or a xacro, with the xacro extra).")]


@Parameter(name="*", group=MODEL)
@dataclass(frozen=True)
class ModelOptions:
    """What a URDF does not tell of itself."""

    package_dir: Annotated[
        list[Path] | None,
        Parameter(help="A folder that contains packages of the URDF, or a workspace; may be repeated.", negative=()),
    ] = None
    xacro_arg: Annotated[
        list[str] | None, Parameter(help="name=value: an argument of a xacro; may be repeated.", negative=())
    ] = None
    geometry: Annotated[
        Literal["visual", "collision"], Parameter(help="Which elements of the URDF give the links their shape.")
    ] = "visual"
    mesh_units: Annotated[
        Literal["ignore", "apply"],
        Parameter(help="Whether the unit that a DAE mesh names scales it; most readers ignore it."),
    ] = "ignore"

    def read(self, urdf: Path) -> ArticulatedModel:
        """Return the model; raises what `ArticulatedModel.from_urdf` raises, and `UsageError`."""
        from pwralign_kin.model import ArticulatedModel

        return ArticulatedModel.from_urdf(
            urdf,
            package_dirs=self.package_dir or (),
            geometry=self.geometry,
            mesh_units=self.mesh_units,
            xacro_args=dict(map(_assignment, self.xacro_arg or ())),
        )


def _assignment(text: str) -> tuple[str, str]:
    """Return name and value of `name=value` (or `name:=value`, as ROS writes it); raises `UsageError` otherwise."""
    name, equals, value = text.partition("=")
    name = name.removesuffix(":")
    if not name or not equals:
        raise UsageError(f"--xacro-arg takes name=value, not {text!r}.")
    return name, value


MODEL_OPTIONS = ModelOptions()
