"""Results of finite element programs as deflection grids: listings, tables, frames, checks and interpolation."""
