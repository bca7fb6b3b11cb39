"""volcal as a library: from measured ball centres to the errors of a machine tool, in a notebook or a script.

The usual order of work is as follows. Read a machine, an artefact and ball centres. Identify the machine with
`identify`, and call `predict` for the error at given axis positions with its covariance, after removal of the rigid
motion that no free artefact shows. Build a `compensation_table` and export it for a controller. Draw the error over the
workspace with `error_map`. Without measurements, `design` chooses positions of the artefact, and `simulate` simulates a
measurement.

Lengths are in mm unless a name says otherwise. Points are axis positions, given as arrays of shape (n, 3) for n points.
No object can be modified after its construction. Terms are defined in docs/reference/glossary.md.

A notebook shows the last value of a cell as a table with its figure. `frame` turns a value into a data frame of pandas,
if that is installed. The version of the library is `volcal.__version__`.

Modules are loaded on first use, and `import volcal` itself is therefore fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.artefact.artefact import Artefact as Artefact
    from twin.artefact.mount_geometry import MountGeometry as MountGeometry
    from twin.artefact.position_set import Position as Position
    from twin.collision.probe_geometry import ProbeGeometry as ProbeGeometry
    from twin.compensation.controllers.export_format import ControllerExport as ControllerExport
    from twin.compensation.table import CompensationTable as CompensationTable
    from twin.errors import DataError as DataError
    from twin.errors import FormatError as FormatError
    from twin.errors import ModelError as ModelError
    from twin.errors import SingularSet as SingularSet
    from twin.errors import TwinError as TwinError
    from twin.formats.ball_file import BallFile as BallFile
    from twin.formats.estimate_file import StoredEstimate as StoredEstimate
    from twin.identification.estimate import Estimate as Estimate
    from twin.identification.options import Options as Options
    from twin.machine.machine_description import MachineDescription as MachineDescription
    from twin.machine.volumetric import VolumetricRms as VolumetricRms
    from twin.workpiece.best_place import PlaceMap as PlaceMap
    from twin.workpiece.features import Feature as Feature
    from twin.workpiece.prediction import FeatureError as FeatureError
    from twin.workpiece.prediction import FeaturePrediction as FeaturePrediction
    from volcal.compensation import CONTROLLER_FORMATS as CONTROLLER_FORMATS
    from volcal.compensation import compensation_table as compensation_table
    from volcal.compensation import export_table as export_table
    from volcal.estimation import Prediction as Prediction
    from volcal.estimation import RigidMotionUncertainty as RigidMotionUncertainty
    from volcal.estimation import VolumetricErrors as VolumetricErrors
    from volcal.estimation import identify as identify
    from volcal.estimation import predict as predict
    from volcal.estimation import predict_unaligned as predict_unaligned
    from volcal.estimation import volumetric_errors as volumetric_errors
    from volcal.figures import error_map as error_map
    from volcal.figures import table_map as table_map
    from volcal.files import read_artefact as read_artefact
    from volcal.files import read_balls as read_balls
    from volcal.files import read_estimate as read_estimate
    from volcal.files import read_machine as read_machine
    from volcal.files import read_positions as read_positions
    from volcal.files import read_table as read_table
    from volcal.files import shipped_file as shipped_file
    from volcal.files import write_balls as write_balls
    from volcal.files import write_estimate as write_estimate
    from volcal.files import write_positions as write_positions
    from volcal.files import write_table as write_table
    from volcal.frames import frame as frame
    from volcal.measuring_setup import MeasuringSetup as MeasuringSetup
    from volcal.measuring_setup import case_study as case_study
    from volcal.position_design import Design as Design
    from volcal.position_design import design as design
    from volcal.position_design import evaluate as evaluate
    from volcal.simulation import Simulation as Simulation
    from volcal.simulation import simulate as simulate
    from volcal.workpiece import place_map as place_map
    from volcal.workpiece import predict_features as predict_features
    from volcal.workpiece import read_features as read_features

_MODULES = {
    "volcal.files": (
        "shipped_file",
        "read_machine",
        "read_artefact",
        "read_balls",
        "read_positions",
        "read_estimate",
        "read_table",
        "write_balls",
        "write_positions",
        "write_estimate",
        "write_table",
    ),
    "volcal.measuring_setup": ("MeasuringSetup", "case_study"),
    "volcal.estimation": (
        "identify",
        "predict",
        "predict_unaligned",
        "volumetric_errors",
        "Prediction",
        "RigidMotionUncertainty",
        "VolumetricErrors",
    ),
    "volcal.workpiece": ("read_features", "predict_features", "place_map"),
    "volcal.position_design": ("design", "evaluate", "Design"),
    "volcal.simulation": ("simulate", "Simulation"),
    "volcal.compensation": ("compensation_table", "export_table", "CONTROLLER_FORMATS"),
    "volcal.figures": ("error_map", "table_map"),
    "volcal.frames": ("frame",),
    "twin.machine.machine_description": ("MachineDescription",),
    "twin.artefact.artefact": ("Artefact",),
    "twin.artefact.position_set": ("Position",),
    "twin.artefact.mount_geometry": ("MountGeometry",),
    "twin.collision.probe_geometry": ("ProbeGeometry",),
    "twin.formats.ball_file": ("BallFile",),
    "twin.identification.options": ("Options",),
    "twin.identification.estimate": ("Estimate",),
    "twin.formats.estimate_file": ("StoredEstimate",),
    "twin.machine.volumetric": ("VolumetricRms",),
    "twin.workpiece.features": ("Feature",),
    "twin.workpiece.prediction": ("FeaturePrediction", "FeatureError"),
    "twin.workpiece.best_place": ("PlaceMap",),
    "twin.compensation.table": ("CompensationTable",),
    "twin.compensation.controllers.export_format": ("ControllerExport",),
    "twin.errors": ("TwinError", "ModelError", "DataError", "FormatError", "SingularSet"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = list(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """Load and return the library's object `name` on first use. Raises AttributeError if the library has no such
    name."""
    if name == "__version__":
        return import_module("importlib.metadata").version("volcal")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'volcal' has no attribute '{name}'")
    value = getattr(import_module(_MODULE_OF[name]), name)
    import_module("twin.display").render_with(_html_of)
    globals()[name] = value
    return value


def _html_of(value: object) -> str | None:
    """Return the HTML that a notebook shows for a value of the library."""
    html: str | None = import_module("volcal.display").html_of(value)
    return html


def __dir__() -> list[str]:
    return sorted(__all__)
