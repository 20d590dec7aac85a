"""What it costs to solve in a process of its own: each step of a day both ways, one after the other."""
