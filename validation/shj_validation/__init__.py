"""What proves shj-bayes and judges the paper: installed beside it, imported by its front alone, never by its rooms.

proof          concealed-effect trials: independent simulators, sealed keys, blind diagnosis, score
calibrate      ranks and coverage of simulated devices and predictions
paper_claims   what the paper says of its tables, against the tables
trials         devices of the development trials
"""
