"""Controllers of thrusters: allocation, attainable forces, azimuths that turn."""
