"""What proves shj-bayes and judges the paper: installed beside it, imported by its front alone, never by its rooms.

proof          concealed-effect trials: independent simulators, sealed keys, blind diagnosis, score
paper_claims   what the paper says of its tables, against the tables
"""
