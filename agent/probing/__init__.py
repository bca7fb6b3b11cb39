"""Measuring plans. A plan is a generator of immutable steps and has no access to hardware, clock, random numbers or
I/O."""
