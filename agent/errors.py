"""Errors that a run of the application raises because of its own decisions; a device cannot raise them.

::

    VolcalError (drivers/errors.py)
    ├── UserError (drivers/errors.py)
    │   ├── EndpointUnavailable   an endpoint cannot be opened, and the service goes on without it
    │   └── NotAllowedInState     the service cannot carry out the request in its present state
    ├── DeviceError (drivers/errors.py)
    │   └── PermissionMissing (drivers/errors.py)
    │       └── ResetMissing      the last run ended with a fault or an abort that nobody has acknowledged
    └── RunError                  decision of the run itself                          exit code 4
        ├── PlanRefused           the preflight found a violated limit, a collision or an unreachable ball
        ├── GateRefused           the estimate must not become a table
        ├── ForecastRefused       a gate is expected to refuse a run with these settings  exit code 7
        ├── MeasurementFault      a ball, a probe check or a drift is out of its limits
        │   ├── ThermometerFault  the artefact's temperature is missing or jumps; the run can be resumed
        │   ├── ArtefactMoved     balls are no longer where they were before an interruption
        │   └── PlacementLost     an artefact placed by hand no longer stands where it was measured
        ├── PlanDiverged          recorded steps do not match the rebuilt plan
        ├── JournalFailed         events can no longer be recorded durably (disk full, disk gone)
        ├── Busy                  another run owns the machine
        ├── Aborted               a person requested the abort                        exit code 5
        └── Interrupted           the program had to end; the run can be resumed      exit code 5

The other branches for wrong input (`UserError`) and for errors of devices (`DeviceError`) are in `drivers/errors.py`,
because drivers and simulators raise these errors too.
"""

from __future__ import annotations

from drivers.errors import ConfigurationError, PermissionMissing, UserError, VolcalError


class EndpointUnavailable(ConfigurationError):
    pass


class NotAllowedInState(UserError):
    pass


class ResetMissing(PermissionMissing):
    """Error for a start after a fault or an abort that nobody has acknowledged by a reset. Unlike other missing
    permissions it does not pass by itself: without a person, no night would ever be measured again."""


class RunError(VolcalError):
    exit_code = 4


class PlanRefused(RunError):
    pass


class GateRefused(RunError):
    pass


class ForecastRefused(RunError):
    exit_code = 7


class MeasurementFault(RunError):
    pass


class ThermometerFault(MeasurementFault):
    """Error for a thermometer of the artefact that gives no reading or one that the artefact cannot have, also when it
    is read again. A step of reading raises it and then has no result, so that a resumed run reads again."""


class ArtefactMoved(MeasurementFault):
    pass


class PlacementLost(MeasurementFault):
    """Error for an artefact placed by hand that no longer stands where it was measured. The engine raises it inside the
    plan, which can then ask the operator to place the artefact again."""


class PlanDiverged(RunError):
    pass


class JournalFailed(RunError):
    pass


class Busy(RunError):
    pass


class Aborted(RunError):
    exit_code = 5


class Interrupted(RunError):
    exit_code = 5
