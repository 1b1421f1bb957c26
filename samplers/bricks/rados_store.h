/// Reads bricks from a Ceph cluster through librados, without a gateway.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/bricks/far_bricks.h"

namespace palpate {

/// Makes a store for rados://[user@]pool/folder: the objects of a pool with names that begin with
/// `folder/`. Cluster and key come from Ceph's configuration: CEPH_CONF, else /etc/ceph/ceph.conf
/// and the other default files of librados; then CEPH_ARGS. The default user is admin.
///
/// The first call loads librados.so.2, which starts threads of its own. Throws VolumeError if the
/// address is invalid, or if librados, the configuration, the user, the pool or the key is missing.
/// Also throws it if the cluster does not answer within StoreParams::connect. Rounds `connect` and
/// `stalled` up to seconds.
[[nodiscard]] std::unique_ptr<ObjectStore> makeRadosStore(const std::string& address,
                                                          const StoreParams& params = {});

}  // namespace palpate
