"""Studies of the suite itself, which nothing else imports: the paper reproduced, statistics validated, speed."""
