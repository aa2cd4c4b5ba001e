#!/usr/bin/env bash
# Certificates for the outside links of one robot, with openssl alone.
#   certificates.sh FOLDER ROBOT [HOST...]   an authority, the router's certificate (valid for the names and
#                                            addresses HOST..., and localhost), and one for each role:
#                                            monitor.ROBOT, operator.ROBOT, sensor.ROBOT
#   certificates.sh FOLDER ROBOT --role NAME [DAYS]   one more certificate NAME.ROBOT of the same authority
# What exists is kept, so it can be run again. FOLDER/authority.key makes new members: keep it off the robot.
set -euo pipefail
usage() { sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }
[ $# -ge 2 ] || usage
[ "${3:-}" != --role ] || [ -n "${4:-}" ] || usage
folder=$1
robot=$2
shift 2
days=825
mkdir -p "$folder"
cd "$folder"
umask 077

key() { openssl ecparam -name prime256v1 -genkey -noout | openssl pkcs8 -topk8 -nocrypt -out "$1"; }

fail() { echo "certificates: $*" >&2; exit 1; }

authority() {
  if [ -f authority.key ] && [ -f authority.crt ]; then return; fi
  [ ! -e authority.key ] && [ ! -e authority.crt ] ||
    fail "$folder has only one of authority.key and authority.crt: put the other there, or remove it to make a new authority"
  key authority.key
  openssl req -x509 -new -key authority.key -sha256 -days 3650 -subj "/CN=authority.$robot" \
    -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign,cRLSign" -out authority.crt
  chmod 644 authority.crt
}

names() { openssl x509 -in "$1" -noout -ext subjectAltName | sed '1d; s/IP Address:/IP:/g; s/ //g'; }

# kept NAME SUBJECT_ALT_NAMES: one that exists is of this authority, good for these names, and still valid
kept() {
  openssl x509 -in "$1.crt" -noout -checkend 0 > "$1.log" ||
    fail "$folder/$1.crt has expired: remove it and $1.key, and run this again"
  rm "$1.log"
  openssl verify -no_check_time -CAfile authority.crt "$1.crt" > /dev/null 2>&1 ||
    fail "$folder/$1.crt is not of $folder/authority.crt: remove it and $1.key, and run this again"
  local name asks
  for name in ${2//,/ }; do
    asks=-checkhost
    [ "${name%%:*}" = DNS ] || asks=-checkip
    # openssl knows each spelling of an address, but tells the result by words only.
    if [[ $(openssl x509 -in "$1.crt" -noout "$asks" "${name#*:}") != *"does match"* ]]; then
      fail "$folder/$1.crt exists and is not valid for ${name#*:} (it is for $(names "$1.crt")): remove it and $1.key, and run this again"
    fi
  done
  # It may have been moved to where it is used.
  [ -f "$1.key" ] || echo "certificates: $folder has no $1.key: to make a new pair, remove $1.crt, and run this again"
  echo "certificates: $folder/$1.crt is kept: $(openssl x509 -in "$1.crt" -noout -enddate)"
}

# certificate NAME COMMON_NAME USAGE DAYS SUBJECT_ALT_NAMES
certificate() {
  if [ -f "$1.crt" ]; then kept "$1" "$5"; return; fi
  key "$1.key"
  openssl req -new -key "$1.key" -subj "/CN=$2" -out "$1.csr"
  openssl x509 -req -in "$1.csr" -CA authority.crt -CAkey authority.key -CAcreateserial -sha256 -days "$4" \
    -extfile <(printf 'basicConstraints=CA:FALSE\nkeyUsage=digitalSignature\nextendedKeyUsage=%s\nsubjectAltName=%s\n' "$3" "$5") \
    -out "$1.crt.part" 2> "$1.log" || fail "$1.crt: $(cat "$1.log")"
  chmod 644 "$1.crt.part"
  mv "$1.crt.part" "$1.crt"
  rm "$1.csr" "$1.log"
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
[ "$robot" = robot ] ||
  echo "certificates: deploy/zenoh/secured.json5 has the rules of the robot \"robot\": replace loam/robot/ and .robot there by $robot's"
for role in monitor operator sensor; do
  certificate "$role" "$role.$robot" clientAuth "$days" "DNS:$role.$robot"
done
