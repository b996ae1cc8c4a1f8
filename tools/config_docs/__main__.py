"""Write what is generated from the settings' types: pages in docs/reference, config/schema.json."""

import json
from pathlib import Path

from config_docs.page import configuration_page, library_page
from config_docs.schema import json_schema

ROOT = Path(__file__).resolve().parents[2]

if __name__ == "__main__":
    reference = ROOT / "docs" / "reference"
    (reference / "configuration.md").write_text(configuration_page(), encoding="utf-8")
    library = reference / "library.md"
    library.write_text(library_page(library.read_text(encoding="utf-8")), encoding="utf-8")
    schema = json.dumps(json_schema(), indent=2) + "\n"
    (ROOT / "config" / "schema.json").write_text(schema, encoding="utf-8")
