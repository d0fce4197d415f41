"""What accuracy costs in time, on the computer's clock and on the station's."""
