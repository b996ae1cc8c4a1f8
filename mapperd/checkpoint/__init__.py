"""The whole state of the estimators as bytes, and back: what a kill must not lose."""
