#!/usr/bin/env bash
# Makes keys for sites that meet over a network that others can reach (docs/sites.md). Each site gets a folder, which
# you copy to its machine. Keep the folder `ca` secret: its key makes keys for further sites.
#   site_keys.sh FOLDER SITE...   if FOLDER exists, adds sites to it
set -euo pipefail

[ $# -ge 2 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0" >&2; exit 2; }
command -v openssl >/dev/null || { echo "site_keys.sh: openssl is missing: install it" >&2; exit 1; }
folder=$1
shift
[ "$(printf '%s\n' "$@" | sort -u | wc -l)" -eq $# ] || {
    echo "site_keys.sh: a site is given twice: give each site once" >&2; exit 2; }
for site in "$@"; do
    [[ $site =~ ^[A-Za-z0-9_-]{1,31}$ ]] && [ "$site" != ca ] || {
        echo "site_keys.sh: \"$site\" is not a name: give 1 to 31 letters, digits, - and _, but not ca" >&2; exit 2; }
    [ ! -e "$folder/$site" ] || { echo "site_keys.sh: $folder/$site exists: remove it first" >&2; exit 1; }
done
umask 077
mkdir -p "$folder"
days=3650
key() { openssl ecparam -name prime256v1 -genkey -noout -out "$1"; }
sign() { openssl smime -sign -in "$1" -text -out "$2" -signer "$folder/ca/cert.pem" -inkey "$folder/ca/key.pem"; }

# An interrupted run leaves a folder whose name ends in .new. The next run replaces it if it is empty or contains
# key.pem. A site cannot have this name.
fresh() {
    [ ! -e "$1" ] || [ -e "$1/key.pem" ] || rmdir "$1" 2>/dev/null || {
        echo "site_keys.sh: $1 exists without keys: remove it first" >&2; exit 1; }
    rm -rf "$1"
    mkdir "$1"
}
if [ ! -e "$folder/ca" ]; then
    fresh "$folder/ca.new"
    key "$folder/ca.new/key.pem"
    openssl req -x509 -new -key "$folder/ca.new/key.pem" -days $days -subj "/CN=palpate sites" \
        -out "$folder/ca.new/cert.pem"
    mv "$folder/ca.new" "$folder/ca"
fi
# Participants without keys are ignored. All messages are encrypted, except the first announcements and the handshakes
# of participants.
cat >"$folder/ca/governance.xml" <<END
<?xml version="1.0" encoding="UTF-8"?>
<dds><domain_access_rules><domain_rule>
  <domains><id_range><min>0</min><max>230</max></id_range></domains>
  <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
  <enable_join_access_control>true</enable_join_access_control>
  <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
  <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
  <rtps_protection_kind>ENCRYPT</rtps_protection_kind>
  <topic_access_rules><topic_rule>
    <topic_expression>palpate_*</topic_expression>
    <enable_discovery_protection>true</enable_discovery_protection>
    <enable_liveliness_protection>true</enable_liveliness_protection>
    <enable_read_access_control>true</enable_read_access_control>
    <enable_write_access_control>true</enable_write_access_control>
    <metadata_protection_kind>NONE</metadata_protection_kind>
    <data_protection_kind>NONE</data_protection_kind>
  </topic_rule></topic_access_rules>
</domain_rule></domain_access_rules></dds>
END
sign "$folder/ca/governance.xml" "$folder/ca/governance.p7s"
for site in "$@"; do
    at=$folder/$site.new
    fresh "$at"
    key "$at/key.pem"
    openssl req -new -key "$at/key.pem" -subj "/CN=$site" -out "$at/request"
    openssl x509 -req -in "$at/request" -CA "$folder/ca/cert.pem" -CAkey "$folder/ca/key.pem" -CAcreateserial \
        -days $days -out "$at/cert.pem" 2>/dev/null
    cat >"$at/permissions.xml" <<END
<?xml version="1.0" encoding="UTF-8"?>
<dds><permissions><grant name="$site">
  <subject_name>CN=$site</subject_name>
  <validity><not_before>2020-01-01T00:00:00</not_before><not_after>2120-01-01T00:00:00</not_after></validity>
  <allow_rule>
    <domains><id_range><min>0</min><max>230</max></id_range></domains>
    <publish><topics><topic>palpate_*</topic></topics></publish>
    <subscribe><topics><topic>palpate_*</topic></topics></subscribe>
  </allow_rule>
  <default>DENY</default>
</grant></permissions></dds>
END
    sign "$at/permissions.xml" "$at/permissions.p7s"
    cp "$folder/ca/governance.p7s" "$at/governance.p7s"
    cp "$folder/ca/cert.pem" "$at/identity_ca.cert.pem"
    cp "$folder/ca/cert.pem" "$at/permissions_ca.cert.pem"
    rm "$at/request" "$at/permissions.xml"
    mv "$at" "$folder/$site"
    echo "$folder/$site: copy it to $site, and give it as --site-keys"
done
