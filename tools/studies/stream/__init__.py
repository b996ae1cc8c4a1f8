"""How the map stream does on bad links and with many clients: `make stream-study`."""
