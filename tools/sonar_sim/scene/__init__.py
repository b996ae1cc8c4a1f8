"""What is simulated: objects and water, the sonar, its vehicle and their path."""
