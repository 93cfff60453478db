"""`bcid-validate bench`: bcid against its peers, each in a process of its own."""
