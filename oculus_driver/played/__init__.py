"""The pretended sonar behind `oculus_driver.play`: pure parts, without sockets or clock."""
