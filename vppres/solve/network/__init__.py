"""Masters in the network: injections with limits as needed, and what they decide."""
