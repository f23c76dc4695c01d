"""Studies of the suite itself, which nothing else imports: the paper reproduced, calibration, speed."""
