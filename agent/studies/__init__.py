"""Studies of the procedure. Each study examines a case by simulation and in closed form, and produces a figure with its
numbers.

A study is a function `run(case: StudyCase) -> StudyResult` in a module of this package. `STUDIES` lists these functions
by name.
"""

STUDIES: dict[str, str] = {
    "design": "agent.studies.design:run",
    "valuation": "agent.studies.valuation:run",
    "uncertainty": "agent.studies.uncertainty:run",
    "ball-count": "agent.studies.ball_count:run",
    "claims": "agent.studies.published.claim_study:run",
    "coverage": "agent.studies.coverage:run",
    "misalignment": "agent.studies.misalignment:run",
    "monte-carlo": "agent.studies.monte_carlo:run",
    "sequential": "agent.studies.sequential:run",
    "strategy": "agent.studies.strategy:run",
    "trajectory": "agent.studies.trajectory:run",
    "volumetric-error": "agent.studies.volumetric_error:run",
}
"""Name on the command line → "module:function"; a module is imported only if its study is run."""
