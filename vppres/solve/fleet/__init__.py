"""Masters without network: the fleet as a whole, step by step and by binaries."""
