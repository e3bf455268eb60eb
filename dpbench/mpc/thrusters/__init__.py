"""Controllers of thrusters: allocation, what thrusters attain together, azimuths that turn."""
