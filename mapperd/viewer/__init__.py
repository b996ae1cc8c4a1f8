"""The live map as a page in the browser."""
