"""The live map as a stream over TCP: what is said, in which bytes, and who says it when."""
