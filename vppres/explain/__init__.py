"""Why a day went as it did: phases, a reason for every action, and shadow prices."""
