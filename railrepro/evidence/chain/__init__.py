"""The chain of notebooks that makes all results, the comparison of its products, and the book made of it."""

import sys

# jsonschema, which nbformat imports, would spend a second on grammars for internationalised addresses in each process.
# Notebooks have no such field, so their package counts as not installed.
sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
