"""Drawing only: functions take arrays and give a picture as a data URI, by the diagrams of `canvas`."""
