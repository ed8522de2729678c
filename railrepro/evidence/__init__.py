"""How the evidence is made and judged, on top of the library: runs, claims, uncertainty, report, chapters."""
