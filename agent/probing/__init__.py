"""Plans: generators of immutable steps, with no access to hardware, clock, random numbers or I/O."""
