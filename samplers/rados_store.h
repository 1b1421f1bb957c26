/// Objects from a Ceph cluster, by RADOS itself: no gateway in between.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/far_bricks.h"

namespace palpate {

/// rados://[user@]pool/folder: the objects of a pool whose names begin with `folder/`. The cluster
/// is that of Ceph's configuration: CEPH_CONF, else /etc/ceph/ceph.conf and what else librados
/// looks at; so is the user's key. No user: admin.
///
/// librados.so.2 is loaded at the first call, not before: it takes 7 ms and has 13 threads.
/// Throws VolumeError: it is no address, no librados, no configuration, no such user, pool or key,
/// nobody answers within StoreParams::connect, in seconds, rounded up, as all of its times here.
[[nodiscard]] std::unique_ptr<ObjectStore> makeRadosStore(const std::string& address,
                                                          const StoreParams& params = {});

}  // namespace palpate
