"""The names and settings of `sonar_3d_reconstruction`.

That is the ROS 2 package of a sonar mapper whose documented classes, defaults and update rule this
project started from; other modules refer to it by this name.
"""
