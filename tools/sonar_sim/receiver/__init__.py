"""The receiver: noise, beamforming, gains and quantiser."""
