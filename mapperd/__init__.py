"""Live, trustworthy 3D maps from Oculus multibeam imaging sonars."""
