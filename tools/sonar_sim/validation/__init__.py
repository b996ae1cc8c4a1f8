"""Known answers: one module a case, for the tests and for the page of pictures alike."""
