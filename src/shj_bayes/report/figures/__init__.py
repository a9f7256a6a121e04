"""Drawing only: functions take arrays and give a picture as a data address. matplotlib is imported here alone."""
