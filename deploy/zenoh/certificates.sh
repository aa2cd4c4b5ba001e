#!/usr/bin/env bash
# Certificates for the outside links of one robot, with openssl alone.
#   certificates.sh FOLDER ROBOT [HOST...]   an authority, the router's certificate (valid for the names and
#                                            addresses HOST..., and localhost), and one for each role:
#                                            monitor.ROBOT, operator.ROBOT, sensor.ROBOT
#   certificates.sh FOLDER ROBOT --role NAME [DAYS]   one more certificate NAME.ROBOT of the same authority
# What exists is kept, so it can be run again. FOLDER/authority.key makes new members: keep it off the robot.
set -euo pipefail
[ $# -ge 2 ] || { sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }
folder=$1
robot=$2
shift 2
days=825
mkdir -p "$folder"
cd "$folder"
umask 077

key() { openssl ecparam -name prime256v1 -genkey -noout | openssl pkcs8 -topk8 -nocrypt -out "$1"; }

authority() {
  [ -f authority.key ] && return
  key authority.key
  openssl req -x509 -new -key authority.key -sha256 -days 3650 -subj "/CN=authority.$robot" \
    -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign,cRLSign" -out authority.crt
}

# certificate NAME COMMON_NAME USAGE DAYS SUBJECT_ALT_NAMES
certificate() {
  [ -f "$1.crt" ] && return
  key "$1.key"
  openssl req -new -key "$1.key" -subj "/CN=$2" -out "$1.csr"
  openssl x509 -req -in "$1.csr" -CA authority.crt -CAkey authority.key -CAcreateserial -sha256 -days "$4" \
    -extfile <(printf 'basicConstraints=CA:FALSE\nkeyUsage=digitalSignature\nextendedKeyUsage=%s\nsubjectAltName=%s\n' "$3" "$5") \
    -out "$1.crt" 2>/dev/null
  rm "$1.csr"
  echo "certificates: $folder/$1.crt ($2)"
}

authority
if [ "${1:-}" = --role ]; then
  certificate "$2" "$2.$robot" clientAuth "${3:-$days}" "DNS:$2.$robot"
  exit 0
fi
names=DNS:localhost,IP:127.0.0.1,DNS:router
for host in "$@"; do
  if [[ $host =~ ^[0-9.]+$|: ]]; then names+=,IP:$host; else names+=,DNS:$host; fi
done
certificate router "router.$robot" serverAuth,clientAuth "$days" "$names"
for role in monitor operator sensor; do
  certificate "$role" "$role.$robot" clientAuth "$days" "DNS:$role.$robot"
done
chmod 644 ./*.crt
