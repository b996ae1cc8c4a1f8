"""The settings' page and their JSON schema, from the types."""
