"""A scenario as frozen, checked data: time grid, network, assets, rules."""
