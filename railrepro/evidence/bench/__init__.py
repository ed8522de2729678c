"""Speed of the library and of its peers, and the same car in an independent multibody program."""
