"""Drawing only: functions take arrays and give a picture as a data URI. matplotlib is imported here alone."""
