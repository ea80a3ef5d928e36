uname -a; ip -details link show vcan0; ls -la /dev | head -5; id; date; exit 0
