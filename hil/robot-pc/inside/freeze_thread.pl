# Holds one thread of another process still by ptrace, as a hang would: freeze_thread.pl TID SECONDS (x86-64).
use strict;
use warnings;

my ($thread, $seconds) = @ARGV;
my ($SYS_ptrace, $SEIZE, $INTERRUPT) = (101, 0x4206, 0x4207);
for my $request ($SEIZE, $INTERRUPT) {
    syscall($SYS_ptrace, $request, $thread + 0, 0, 0) == 0 or die sprintf("ptrace %#x of thread %d: %s\n", $request, $thread, $!);
}
print "thread $thread stands still\n";
sleep $seconds;
