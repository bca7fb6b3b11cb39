"""Studies of the procedure: each looks at a case by simulation and in closed form, and leaves a figure and its numbers.

A study is a function `run(case: StudyCase) -> StudyResult` in a module of this package and one line here.
"""

STUDIES: dict[str, str] = {
    "monte-carlo": "agent.studies.monte_carlo:run",
}
"""Name on the command line → "module:function"; imported only when asked for."""
