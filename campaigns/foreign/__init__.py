"""Trial of the identification on machines that share nothing with the program. They have their own transforms, error
functions and deflection, and their true errors are known. The tests of `tests/truth` use the same machines."""
