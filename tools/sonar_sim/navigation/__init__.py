"""The vehicle's odometry in the formats of real vehicles, and the links that carry it."""
