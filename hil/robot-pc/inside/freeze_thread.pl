# Holds one thread of another process still by ptrace, as a hang would, until the process ends: freeze_thread.pl TID SECONDS (x86-64).
use strict;
use warnings;

my ($thread, $seconds) = @ARGV;
my ($SYS_ptrace, $SEIZE, $INTERRUPT, $WALL) = (101, 0x4206, 0x4207, 0x40000000);
for my $request ($SEIZE, $INTERRUPT) {
    syscall($SYS_ptrace, $request, $thread + 0, 0, 0) == 0 or die sprintf("ptrace %#x of thread %d: %s\n", $request, $thread, $!);
}
alarm $seconds;
# Its stop is reported first, then its end: without taking that, the dead process would stay.
while (waitpid($thread, $WALL) == $thread) {
    printf "thread %d: wait status %#x\n", $thread, $?;
}
