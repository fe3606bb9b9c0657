"""The arm: robot file, kinematics, limits, the serial link and its emulator."""
