"""Names of the layouts of ``diagnosis.json``: the one that is written, and those that are read."""

SCHEMA = "shj-bayes/diagnosis/2"
READ = (SCHEMA, "shj-bayes/diagnosis/1")
