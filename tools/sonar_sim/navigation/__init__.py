"""The vehicle's odometry in the formats that vehicles speak, and the links that carry it."""
