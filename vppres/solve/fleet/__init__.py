"""Masters without network: the fleet as a whole, by binaries or by counts with cuts."""
