"""The chain of notebooks and its products; serves no section of the paper but the rerun of all of them."""

import sys

# Below nbformat jsonschema would build 39 grammars for internationalised addresses, a second in each process; so this
# package counts as not installed. Notebooks have no such field.
sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
