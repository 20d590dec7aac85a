"""A pandapower net on its way to a radial feeder."""
