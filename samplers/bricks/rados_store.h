/// Reads bricks from a Ceph cluster through librados, without a gateway.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/bricks/far_bricks.h"

namespace palpate {

/// Makes a store for rados://[user@]pool/folder: the objects of a pool with names that begin with
/// `folder/`. The cluster and the user's key come from Ceph's configuration: CEPH_CONF, else
/// /etc/ceph/ceph.conf and the other places of librados. The default user is admin.
///
/// The first call loads librados.so.2, which takes 7 ms and has 13 threads. Throws VolumeError if
/// the address is invalid, if librados, the configuration, the user, the pool or the key is
/// missing, or if the cluster does not answer within StoreParams::connect. This store rounds all of
/// its times up to seconds.
[[nodiscard]] std::unique_ptr<ObjectStore> makeRadosStore(const std::string& address,
                                                          const StoreParams& params = {});

}  // namespace palpate
