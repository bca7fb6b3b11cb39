"""Trial of the identification on machines that share nothing with the program: own transforms, own error functions, own
deflection, with the truth known. The tests of `tests/truth` use the same machines."""
