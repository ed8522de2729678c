"""The chain of notebooks, which reruns all results, the comparison of its products, and the book made of it."""

import sys

# Below nbformat jsonschema would build 39 grammars for internationalised addresses, a second in each process; so this
# package counts as not installed. Notebooks have no such field.
sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
